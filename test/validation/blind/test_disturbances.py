import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import solve_banded

from tam_validation.blind import instrument_faults, surroundings
from tam_validation.blind.catalogue import CAUSES
from tam_validation.blind.material import _bouc_wen, _diffused, _preisach, low_pass

DRAWS = {name: entry.draw for name, entry in CAUSES.items()}
AMPLITUDES = {
    "of the samples": 0.1,
    "samples a stretch": 8.0,
    "T of the band": 1e-6,
    "s between the bytes": 0.01,
    "of the limit": 0.1,
}
"""By their units, where neither 1e-4 nor, for what the recorder does, 1e-9 is an amplitude."""


@pytest.mark.parametrize("name", DRAWS)
def test_a_cause_disturbs_what_its_key_says(draw, name):
    """No sensor but those of the key is changed by more than a tenth of what they are, and all of theirs are."""
    for seed in range(4):
        scene = draw(seed)
        cause = DRAWS[name](np.random.default_rng(seed), scene)
        amplitude = AMPLITUDES.get(cause.amplitude_unit, 1e-9 if cause.after_noise else 1e-4)
        vectors, scalar = cause.change(amplitude, (scene.readings_T, scene.intensity_T))
        assert cause.effect == name
        size = np.abs(vectors - vectors.mean(axis=0)).mean(axis=0)
        strength = size.max(axis=1)
        if cause.sensors == ("scalar",):
            assert strength.max() == 0 < np.ptp(scalar)
        elif cause.sensors == ("all",):
            assert strength.min() > 0
        else:
            places = [sensor - 1 for sensor in cause.sensors]
            assert np.delete(strength, places).max() <= 0.25 * strength[places].min() > 0
            if cause.axes:
                assert np.flatnonzero(size[places[0]]).tolist() == ["xyz".index(cause.axes[0])]


def test_time_skew_is_the_waveform_of_another_time(draw):
    """A late sensor reads what was there before; the others what is there."""
    scene = draw(2)
    cause = instrument_faults.time_skew(np.random.default_rng(3), scene)
    vectors, _ = cause.change(0.4, (scene.readings_T, scene.intensity_T))
    sensor = cause.sensors[0] - 1
    then = scene.readings_at(scene.time_s - (0.4 if cause.parameters["late"] else -0.4))[:, sensor]
    seen = (scene.readings_T + vectors)[:, sensor]
    axes = ["xyz".index(axis) for axis in cause.axes] or [0, 1, 2]
    assert_allclose(seen[:, axes], then[:, axes])


def test_quantization_leaves_a_lattice(draw):
    """Readings of a coarse converter differ by whole steps."""
    scene = draw(2)
    cause = instrument_faults.quantization(np.random.default_rng(1), scene)
    vectors, _ = cause.change(5e-8, (scene.readings_T, scene.intensity_T))
    sensor, axis = np.argwhere(np.ptp(vectors, axis=0) > 0)[0]
    steps = np.diff((scene.readings_T + vectors)[:, sensor, axis]) / 5e-8
    assert_allclose(steps, np.round(steps), atol=1e-6)


def test_wire_from_nearby_is_endless():
    """Near its middle a long wire has the field μ0 I / 2πr about it, by the right hand."""
    field = surroundings._wire(np.array([0, 0, -50.0]), np.array([0, 0, 50.0]), np.array([[0.2, 0, 0]]))
    assert_allclose(field, [[0, 2e-7 / 0.2, 0]], rtol=1e-4)


def test_dipole_along_its_axis():
    """On its axis a dipole's field is twice that beside it, and against it there."""
    along, beside = surroundings.dipole(np.array([0, 0, 1.0]), np.array([[0, 0, 2.0], [2.0, 0, 0]]))
    assert_allclose(along, [0, 0, 2e-7 / 8])
    assert_allclose(beside, [0, 0, -1e-7 / 8])


@pytest.mark.parametrize("law", [_preisach, _bouc_wen])
def test_loops_are_closed_and_two_ways(law):
    """After the first cycle the way up and the way down part, and each cycle is like the last."""
    drive = 0.9 * np.sin(np.linspace(0, 6 * np.pi, 1201))
    magnetised, _ = law(np.random.default_rng(4), drive)
    assert_allclose(magnetised[401:801], magnetised[801:1201], atol=0.02)
    up, down = magnetised[400 + 1], magnetised[600]
    assert abs(up - down) > 0.1 * np.ptp(magnetised)


def test_heat_follows_with_its_time_constant():
    """After a step the temperature has gone 1 − 1/e of the way when the time constant is over."""
    time_s = np.linspace(0, 10, 10001)
    outside = np.where(time_s > 0, 1.0, 0.0)
    assert_allclose(np.interp(2.0, time_s, low_pass(outside, 2.0, time_s)), 1 - np.exp(-1), rtol=1e-3)


def test_heat_diffuses_as_by_finite_differences():
    """Through a slab of one hundred cells whose far side loses no heat, implicit in time."""
    time_s, delay_s, cells = np.linspace(0, 60, 6001), 5.0, 100
    outside = np.interp(time_s, [0, 1, 30, 31, 60], [0, 1, 1, -1, 0.5])
    rate = time_s[1] / (2 * delay_s) * cells**2
    bands = np.full((3, cells), -rate)
    bands[1] = 1 + 2 * rate
    bands[1, 0], bands[1, -1] = 1 + 3 * rate, 1 + rate
    inside, far = np.zeros(cells), [0.0]
    for value in outside[1:]:
        inside[0] += 2 * rate * value
        inside = solve_banded((1, 1), bands, inside)
        far.append(inside[-1])
    assert_allclose(_diffused(outside, delay_s, time_s), far, atol=2e-3)
