"""What is beyond any measurement is of another unit or damage, and told before anything overflows."""

import numpy as np
import pytest

from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.limits import LARGEST, LEAST_SPREAD_T, SHORTEST_ATTITUDE
from tam_calibration.model.recording import CHANNELS, COMPONENTS, Recording


def with_value(name, value):
    """Make a recording of four samples in which one number of a field is another."""
    rng = np.random.default_rng(1)
    values = {"time_s": np.arange(4.0), "readings_T": 5e-5 * rng.normal(size=(4, 2, 3)), "attitude": np.eye(4)}
    values |= {channel: np.ones(4) for channel in CHANNELS if channel not in COMPONENTS}
    values["angular_velocity_rad_s"] = np.ones((4, 3))
    values["position_m"] = np.ones((4, 3))
    values["actuator_rudder"] = np.ones(4)
    values[name].reshape(-1)[-1] = value
    return Recording.of_values(values)


LIMITS = {
    "time_s": 9.2e9,
    "readings_T": 1e9,
    "scalar_T": 1e9,
    "temperature_C": 1e4,
    "current_A": 1e6,
    "actuator_rudder": 1e6,
    "attitude": 10.0,
    "angular_velocity_rad_s": 1e4,
    "position_m": 1e8,
}


@pytest.mark.parametrize(("name", "largest"), LIMITS.items())
def test_values_of_a_recording_have_bounds(name, largest):
    """The first that is beyond is told with its place; what is at the bound is taken."""
    with_value(name, largest)
    place = "sensor 2 axis z" if name == "readings_T" else name
    with pytest.raises(InputError, match=rf"^1 of 4 samples hold .*, first {place} in sample 4, between .* s: .* unit"):
        with_value(name, 1.001 * largest)
    with pytest.raises(InputError, match="infinite values"):
        with_value(name, np.inf)
    assert len(LARGEST) == len(LIMITS)


def test_an_attitude_has_a_length():
    """Numbers that are all next to nothing are no attitude."""
    attitude = np.tile([0, 0, 0, 1.0], (4, 1))
    for length in (1.001, 0.999):
        attitude[2, 3] = length * SHORTEST_ATTITUDE
        recording = {"time_s": np.arange(4.0), "readings_T": np.full((4, 1, 3), 5e-5), "attitude": attitude.copy()}
        if length > 1:
            Recording(**recording)
        else:
            with pytest.raises(InputError, match="1 of 4 attitudes are four zeros, first in sample 3"):
                Recording(**recording)
    assert SHORTEST_ATTITUDE == 1e-3


def test_an_axis_that_hardly_moves_is_not_connected():
    """Its numbers differ by less than the noise of any sensor."""
    rng = np.random.default_rng(2)
    readings = 5e-5 * rng.normal(size=(50, 1, 3))
    for spread_T in (2 * LEAST_SPREAD_T, 0.5 * LEAST_SPREAD_T):
        readings[:, 0, 1] = np.linspace(0, spread_T, 50)
        recording = Recording(np.arange(50.0), readings.copy())
        if spread_T > LEAST_SPREAD_T:
            recording.check_plausible()
        else:
            with pytest.raises(InputError, match="sensor 1 axis y reads the same value in all 50 samples"):
                recording.check_plausible()
    assert LEAST_SPREAD_T == 1e-15


@pytest.mark.parametrize(
    ("make", "bound", "beyond", "sentence"),
    [
        (lambda x: Array([[x, 0, 0]]), 1e3, 1.1, "the position of a sensor is 1100 m, and lies within 0 to 1000 m"),
        (lambda x: Array([[0, 0, 0]], scalar_position_m=[0, -x, 0]), 1e3, 1.1, "position of the scalar magnetometer"),
        (lambda x: Array([[0, 0, 0]], axis_offsets_m=np.full((1, 3, 3), x)), 1e3, 1.1, "the offset of an axis"),
        (
            lambda x: Array.cross(x),
            1e3,
            1.1,
            "the baseline is 1100 m, and lies within 0.0001 to 1000 m: check the unit",
        ),
        (lambda x: Array.cross(x), 1e-4, 0.9, "the baseline is 9e-05 m"),
        (lambda x: Array.cross(0.5, x), 1e-3, 1.1, "the noise of a sensor is 0.0011 T"),
        (lambda x: Array.cross(0.5, x), 1e-35, 0.9, "the noise of a sensor is 9e-36 T"),
        (lambda x: Array.cross(0.5, None, x), 1e-3, 1.1, "the noise of the scalar magnetometer is 0.0011 T"),
        (lambda x: Array.cross(0.5, None, x), 1e-35, 0.9, "the noise of the scalar magnetometer is 9e-36 T"),
        (
            lambda x: Array([[0, 0, 0]], delay_s=[-x]),
            60.0,
            1.1,
            "the delay of a sensor is 66 s, and lies within 0 to 60 s",
        ),
        (lambda x: Array([[0, 0, 0]], scalar_delay_s=x), 60.0, 1.1, "the delay of the scalar magnetometer is 66 s"),
    ],
)
def test_quantities_of_an_array_have_bounds(make, bound, beyond, sentence):
    """What is at the bound is taken; beyond, the unit is questioned."""
    make(bound)
    with pytest.raises(InputError, match=sentence):
        make(bound * beyond)
