"""Sensors that fail during a survey are found without a scalar; sources that are passed are no failure."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.correction.streaming import ContradictionSearch
from tam_calibration.fit import calibrate
from tam_calibration.sources.dipole import dipole_field


@pytest.fixture(scope="module")
def calibration(recording, cross):
    """Return a calibration of the cross."""
    return calibrate(recording, cross)


FAILURES = {
    "a sign": lambda readings: -readings,
    "frozen": lambda readings: np.repeat(readings[:1], len(readings), axis=0),
    "too large": lambda readings: 3 * readings,
    "an axis": lambda readings: readings * [1, -1, 1],
}


@pytest.mark.parametrize("sensor", [0, 3])
@pytest.mark.parametrize("kind", FAILURES)
def test_a_sensor_that_fails_is_told(calibration, recording, kind, sensor):
    """In nearly all samples from then on, in pieces of any size, and no other sensor in any."""
    readings_T = recording.readings_T.copy()
    readings_T[200:, sensor] = FAILURES[kind](readings_T[200:, sensor])
    failing, parts = ContradictionSearch(calibration), np.split(np.arange(600), [150, 420])
    changed = replace(recording, readings_T=readings_T)
    codes = np.concatenate([failing.codes_of(changed.time_s[part], changed.readings_T[part]) for part in parts])
    assert set(codes.tolist()) == {0, 1 << sensor}
    assert not codes[:200].any() and np.count_nonzero(codes) > 0.9 * 400
    [sentence] = failing.sentences()
    assert sentence.startswith(
        f"{np.count_nonzero(codes)} of 600 readings of sensor {sensor + 1} contradict the others"
    )
    times = ", ".join(f"{time:.2f}" for time in recording.time_s[codes > 0][:3] - recording.time_s[0])
    assert sentence.endswith(f"are left out, first at {times} s")


@pytest.mark.parametrize("distance_m", [0.6, 1.0, 3.0])
def test_a_source_is_no_failure(calibration, recording, cross, distance_m):
    """However strong, and in whatever direction."""
    rng = np.random.default_rng(4)
    place = rng.normal(size=(600, 3))
    place_m = distance_m * place / np.linalg.norm(place, axis=1, keepdims=True)
    moment = rng.normal(size=(600, 3))
    moment_Am2 = 300 * moment / np.linalg.norm(moment, axis=1, keepdims=True)
    field_T = dipole_field(cross.positions_m - place_m[:, None], moment_Am2[:, None])[0]
    added_T = np.einsum("kij,nkj->nki", calibration.errors.matrix, field_T)
    near = replace(recording, readings_T=recording.readings_T + added_T)
    failing = ContradictionSearch(calibration)
    assert not failing.codes_of(near.time_s, near.readings_T).any() and list(failing.sentences()) == []


def test_two_sensors_are_not_judged(calibration, recording):
    """Neither outvotes the other."""
    errors = calibration.errors
    first_two = type(errors).from_vector(errors.to_vector()[:2], errors.orientation[:2])
    readings_T = recording.readings_T[:, :2] * [[1], [-1]]
    failing = ContradictionSearch(replace(calibration, errors=first_two))
    assert not failing.codes_of(recording.time_s, readings_T).any()
