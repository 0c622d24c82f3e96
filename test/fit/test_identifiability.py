"""What a recording determines badly is named, with the attitudes that it lacks."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.fit.identifiability import find_weakness, open_parameters, require_accurate, require_determined
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import from_degrees
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import RandomAttitudes, ThreeAxisTurns

FIELD = 54955.83e-9 * np.array([0.42, 0.21, -0.883]) / np.linalg.norm([0.42, 0.21, -0.883])


def turned(errors, rotation, noise_T=1e-9):
    """Return the noisy recording of an array turned by rotations in a uniform field."""
    readings = errors.distort(rotation.inv().apply(FIELD))
    count = len(readings)
    noise = noise_T * np.random.default_rng(5).standard_normal(readings.shape)
    return Recording(np.arange(count) * 0.1, readings + noise, np.full(count, np.linalg.norm(FIELD)))


def test_open_parameters_have_names_that_need_no_paper():
    """Angles by their kind; what has an axis by that."""
    errors = np.zeros((2, 12))
    errors[:, 3:7] = np.inf
    assert open_parameters(errors, 5e-5) == "non-orthogonality, bias x of every sensor"


def turn(axis, count=120):
    """Return one full turn about an axis."""
    return Rotation.from_euler(axis, np.linspace(0, 360, count, endpoint=False)[:, None], degrees=True)


@pytest.mark.parametrize("noise_T", [0.0, 1e-9, 50e-9])
@pytest.mark.parametrize(("axis", "open_"), [("z", "bias z"), ("x", "bias x"), ("y", "bias y")])
def test_a_single_turn_names_the_bias_along_its_axis(wu_run, wu_scenario, axis, open_, noise_T):
    """One turn about one axis leaves the bias along it open, with or without noise."""
    with pytest.raises(InputError, match=rf"do not determine .*{open_}.* of every sensor"):
        require_determined(turned(wu_run.errors, turn(axis), noise_T), wu_scenario.array)


@pytest.mark.parametrize("cone_deg", [0, 10])
@pytest.mark.parametrize("axis", ["x", "y", "z"])
@pytest.mark.parametrize("noise_T", [0.0, 0.1e-9, 2e-9, 20e-9, 100e-9, 400e-9, 1e-6])
def test_what_lacks_directions_asks_to_turn_whatever_the_noise(wu_run, wu_scenario, axis, cone_deg, noise_T):
    """Turns in a plane or a narrow cone: noise passes neither for directions nor for the reason."""
    generator = np.random.default_rng(6)
    tilt = Rotation.from_rotvec(from_degrees(cone_deg) * generator.uniform(-0.1, 0.1, (120, 3)))
    with pytest.raises(InputError, match=r"do not determine .*: turn the array"):
        require_determined(turned(wu_run.errors, tilt * turn(axis), noise_T), wu_scenario.array)


def test_two_turns_leave_one_combination_open_and_three_none(wu_run, wu_scenario):
    """Turns about z and x have rank 44 of 45 (Li 2018b); a third one about y completes it."""
    two = Rotation.concatenate([turn("z"), turn("x")])
    with pytest.raises(InputError, match="bias x"):
        require_determined(turned(wu_run.errors, two), wu_scenario.array)
    three = Rotation.concatenate([two, turn("y")])
    require_determined(turned(wu_run.errors, three), wu_scenario.array)


def test_too_few_samples_are_told_with_the_number_of_parameters(wu_run, wu_scenario):
    """Eight samples for 45 parameters are refused with both numbers."""
    with pytest.raises(InputError, match="8 samples cannot determine the 45 parameters of 4 sensors"):
        require_determined(wu_run.recording.take(slice(0, 8)), wu_scenario.array)


def test_too_few_scalar_readings_are_told(wu_run, wu_scenario):
    """A scalar channel with three readings is neither a reference nor none."""
    sparse = np.full(wu_run.recording.sample_count, np.nan)
    sparse[:3] = 54955.83e-9
    with pytest.raises(InputError, match="only 3 samples have a scalar reading"):
        require_determined(replace(wu_run.recording, scalar_T=sparse), wu_scenario.array)


def test_a_large_standard_error_names_its_parameter(wu_run, wu_scenario):
    """After a fit a useless parameter is named with its sensor."""
    calibration = maximum_likelihood(wu_run.recording, wu_scenario.array)
    require_accurate(calibration, wu_run.recording)
    poor = calibration.covariance.copy()
    poor[31, 31] = 1e-12
    with pytest.raises(InputError, match="the noise leaves bias y of sensor 3 open, although the directions"):
        require_accurate(replace(calibration, covariance=poor), wu_run.recording)
    one_turn = turned(wu_run.errors, turn("z"))
    with pytest.raises(InputError, match="do not determine bias y of sensor 3: turn the array"):
        require_accurate(replace(calibration, covariance=poor), one_turn)


def test_noise_that_leaves_a_parameter_open_may_be_accepted(wu_run, wu_scenario):
    """It is a warning then, and is told to be accepted; directions that are not enough are refused all the same."""
    calibration = maximum_likelihood(wu_run.recording, wu_scenario.array)
    assert require_accurate(calibration, wu_run.recording, ["accuracy"]).accepted == ()
    poor = replace(calibration, covariance=calibration.covariance.copy())
    poor.covariance[31, 31] = 1e-12
    taken = require_accurate(poor, wu_run.recording, ["accuracy"])
    assert taken.accepted == ("accuracy",) and "the noise leaves bias y of sensor 3 open" in taken.warnings[0]
    with pytest.raises(InputError, match="do not determine bias y of sensor 3: turn the array"):
        require_accurate(poor, turned(wu_run.errors, turn("z")), ["accuracy"])


@pytest.mark.parametrize("channel", ["differential", "common_mode"])
def test_how_long_a_residual_lasts_refuses_nothing(wu_run, wu_scenario, channel):
    """A standard error that is large only since residuals of one channel last is told, and not refused."""
    calibration = maximum_likelihood(wu_run.recording, wu_scenario.array)
    wide = replace(calibration, covariance=1e6 * calibration.covariance)
    wide.covariance[31, 31] = 1e-12
    with pytest.raises(InputError, match="the noise leaves bias y of sensor 3 open"):
        require_accurate(wide, wu_run.recording)
    require_accurate(replace(wide, reduced_chi_square={f"slow_{channel}": 1e6}), wu_run.recording)


@dataclass(frozen=True)
class Swings:
    """Independent attitudes, uniform within limits of yaw, pitch and roll in degrees."""

    limits_deg: tuple[float, float, float]

    def attitudes(self, time_s, generator):
        """Return their quaternions."""
        angles = generator.uniform(-1, 1, (len(time_s), 3)) * from_degrees(np.array(self.limits_deg))
        return Rotation.from_euler("ZYX", angles).as_quat()


def weakness_of(wu_scenario, motion, count=2000, **changes):
    """Return the weakness of a recording of a motion, in a field of 62.3° inclination."""
    run = simulate(replace(wu_scenario, motion=motion, sample_count=count))
    recording = replace(run.recording, **changes)
    return find_weakness(recording, maximum_likelihood(recording, wu_scenario.array))


@pytest.mark.parametrize("motion", [RandomAttitudes(), ThreeAxisTurns()])
def test_attitudes_all_round_leave_nothing_to_say(wu_scenario, motion):
    """Neither random attitudes nor three full turns leave a parameter badly determined."""
    weakness = weakness_of(wu_scenario, motion)
    assert weakness.parameters == () and weakness.reason == "" and str(weakness) == ""


def test_random_attitudes_are_as_good_as_the_full_sphere(wu_scenario):
    """Each free parameter is as well determined as over the full sphere, and what is fixed has no ratio."""
    relative = weakness_of(wu_scenario, RandomAttitudes(), 20_000).relative_error
    assert np.isnan(relative[0, 9:]).all()
    assert_allclose(relative[~np.isnan(relative)], 1, atol=0.05)


def test_a_vehicle_with_little_tilt(wu_scenario):
    """At ±30° of pitch and roll bias z is 31 and scale factor z 20 times worse; the height of the field tells why."""
    weakness = weakness_of(wu_scenario, Swings((180, 30, 30)), 10_000)
    assert_allclose(weakness.relative_error[:, [8, 2]].mean(axis=0), [31, 20], rtol=0.1)
    assert weakness.parameters[0].startswith("bias z of every sensor 3")
    assert weakness.parameters[1].startswith("scale factor z of every sensor 2")
    assert len(weakness.parameters) == 3
    assert "z component in the array frame only spans −55 to −2" in weakness.reason
    assert weakness.reason.endswith("of ±55 µT: pitch and roll further.")


@pytest.mark.parametrize(
    ("limits_deg", "component", "advice"),
    [((20, 20, 180), "x", "pitch and yaw"), ((15, 180, 15), "y", "roll and yaw")],
)
def test_the_turns_that_are_missing_are_named(wu_scenario, limits_deg, component, advice):
    """A recording that turned about one axis alone lacks the turns about the two others."""
    weakness = weakness_of(wu_scenario, Swings(limits_deg))
    assert f"The field's {component} component" in weakness.reason
    assert weakness.reason.endswith(f"{advice} further.")
    assert f" {component} of every sensor" in weakness.parameters[0]


def test_a_gap_in_wide_coverage_is_a_direction(wu_scenario):
    """Where every component spans its range, the direction in which the field never points is named."""
    generator = np.random.default_rng(0)
    axes = np.repeat(np.concatenate([np.eye(3), -np.eye(3)]), 200, axis=0)
    near_axes = axes + 0.02 * generator.standard_normal(axes.shape)
    near_axes /= np.linalg.norm(near_axes, axis=1, keepdims=True)
    field = 5e-5 * near_axes
    readings = wu_scenario.errors.distort(field) + 1e-9 * generator.standard_normal((len(axes), 4, 3))
    run = simulate(replace(wu_scenario, sample_count=len(axes)))
    recording = replace(run.recording, readings_T=readings, scalar_T=np.full(len(axes), 5e-5))
    weakness = find_weakness(recording, maximum_likelihood(recording, wu_scenario.array))
    assert any("non-orthogonality" in name for name in weakness.parameters)
    assert weakness.reason.startswith("The field never points ")
    assert " and " in weakness.reason


def test_only_samples_with_a_scalar_count(wu_scenario):
    """Where the scalar fell silent beyond little tilt, the recording is as weak as if it had not gone further."""
    run = simulate(replace(wu_scenario, motion=Swings((180, 60, 60)), sample_count=6000))
    up = run.center_field_T[:, 2]
    silent = replace(run.recording, scalar_T=np.where(up < np.median(up), run.recording.scalar_T, np.nan))
    calibration = maximum_likelihood(run.recording, wu_scenario.array)
    whole, part = (find_weakness(recording, calibration) for recording in (run.recording, silent))
    assert part.relative_error[1, 8] > 2 * whole.relative_error[1, 8]


def test_without_scalar(wu_scenario):
    """With an unknown constant intensity the tilt matters as much."""
    weakness = weakness_of(wu_scenario, Swings((180, 30, 30)), scalar_T=None)
    assert "bias z of every sensor" in str(weakness)


def test_beside_effects_differences_of_the_sensors_are_no_noise(wu_run, wu_scenario):
    """30 µT between the sensors contradict noise of 1 nT; noise that is stated so loud leaves all open in any case."""
    recording, array = wu_run.recording, wu_scenario.array
    loud = replace(array, vector_noise_T=np.full(4, 30e-6))
    for has_effects in (True, False):
        with pytest.raises(InputError, match=r"the noise leaves .* open, although the directions are enough"):
            require_determined(recording, loud, has_effects)
    apart = 30e-6 * np.random.default_rng(6).normal(size=recording.readings_T.shape)
    differing = replace(recording, readings_T=recording.readings_T + apart)
    with pytest.raises(Refused, match=r"the residual is .* times the noise, .* although the directions are enough"):
        require_determined(differing, array)
    require_determined(differing, array, has_effects=True)


def test_of_one_sensor_too_the_three_worst_parameters_are_named(wu_scenario):
    """As of four: it is parameters that are counted."""
    run = simulate(replace(wu_scenario, motion=Swings((180, 30, 30)), sample_count=2000))
    alone = replace(run.recording, readings_T=run.recording.readings_T[:, :1])
    weakness = find_weakness(alone, maximum_likelihood(alone, Array(np.zeros((1, 3)), np.array([1e-9]), 1e-10)))
    assert len(weakness.parameters) == 3
    assert weakness.parameters[0].startswith("bias z of sensor 1 ")


@pytest.mark.parametrize(("noise_T", "is_open"), [(2.3e-6, False), (3.2e-6, True)])
def test_a_scale_factor_is_open_from_half_a_per_cent_on(wu_run, wu_scenario, noise_T, is_open):
    """360 attitudes all round leave σ/F √(3.75/360) of it: half a per cent at 2.7 µT of noise in 55 µT."""
    loud = replace(wu_scenario.array, vector_noise_T=np.full(4, noise_T))
    if not is_open:
        require_determined(wu_run.recording, loud)
        return
    with pytest.raises(InputError, match=r"the noise leaves scale factor .* open"):
        require_determined(wu_run.recording, loud)
