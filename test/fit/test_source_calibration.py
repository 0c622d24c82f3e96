"""What a known source shows of an array."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.prior import turned
from tam_calibration.fit.source_calibration import SourceCalibration, calibrate_by_source, complete
from tam_calibration.localization.turned_samples import Samples, locate_each
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.mounting import rotation_matrix
from tam_calibration.model.recording import Recording
from tam_calibration.results.calibration_yaml import calibration_from_yaml, calibration_to_yaml
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate
from tam_calibration.sources.demodulation import amplitudes_of
from tam_calibration.sources.dipole import Dipole, Loop

ARRAY = Array.cross(0.21)
SOURCE = Loop(np.array([2.4, -1.0, 0.46]), np.array([250.0, -280.0, 240.0]), 0.445)
TURNS = Rotation.from_euler("z", np.arange(12)[:, None] * np.pi / 6)
POSES = TURNS.as_quat()
FREQUENCY_HZ = 10.0
OFFSETS_M = 5e-3 * np.random.default_rng(61).normal(size=(4, 3, 3))
OFFSETS_M -= ARRAY.positions_m[:, None] * np.sum(ARRAY.positions_m[:, None] * OFFSETS_M) / (12 * 0.105**2)
TRUTH = SourceCalibration(0.95, np.array([0.01, -0.02, 0.015]), OFFSETS_M, np.zeros((40, 40)), 0.0, 0)


@pytest.fixture(scope="module")
def scenario():
    """Return Wu's turntable with 0.1 nT of noise and no drift."""
    return replace(read_scenario("wu_turntable"), drift=None)


@pytest.fixture(scope="module")
def errors(scenario):
    """Return the errors in the frame of sensor 1."""
    return scenario.errors


def amplitudes(errors, source=SOURCE, truth=TRUTH):
    """Return the raw amplitudes (N, K, 3) that the true array reads, written down independently of the fit."""
    rows, places = errors.matrix @ rotation_matrix(truth.rotation), truth.array_of(ARRAY).element_positions_m
    raw = np.zeros((12, 4, 3))
    for pose, turn in enumerate(TURNS.as_matrix()):
        for sensor in range(4):
            for axis in range(3):
                field = turn.T @ source.field_T(turn @ places[sensor, axis])
                raw[pose, sensor, axis] = rows[sensor, axis] @ field
    return raw


@pytest.mark.parametrize("source", [SOURCE, Dipole(SOURCE.position_m, SOURCE.moment_Am2)], ids=["loop", "dipole"])
def test_all_three_are_found_exactly(errors, source):
    """Baselines, frame and places of all axes, whatever the sign of each pose."""
    signs = np.where(np.arange(12) % 3, 1, -1)[:, None, None]
    found = calibrate_by_source(signs * amplitudes(errors, source), 5e-11, source, POSES, errors, ARRAY)
    assert_allclose(found.parameters, TRUTH.parameters, atol=1e-10)
    assert found.degrees_of_freedom == 144 - 39
    assert found.chi_square < 1e-10


def test_standard_errors_are_those_of_repeated_measurements(errors):
    """And small: micrometres and microradians from 0.05 nT."""
    generator, exact = np.random.default_rng(62), amplitudes(errors)
    fits = [
        calibrate_by_source(exact + 5e-11 * generator.normal(size=exact.shape), 5e-11, SOURCE, POSES, errors, ARRAY)
        for _ in range(40)
    ]
    pulls = np.array([(fit.parameters - TRUTH.parameters) / fit.standard_errors for fit in fits])
    for part in (slice(0, 1), slice(1, 4), slice(4, None)):
        assert np.mean(pulls[:, part] ** 2) == pytest.approx(1, abs=0.35)
    assert np.mean([fit.chi_square for fit in fits]) == pytest.approx(105, abs=6)
    assert fits[0].standard_errors.max() < 3e-4


def test_poses_that_show_too_little_are_refused(errors):
    """Two headings have fewer values than there are unknowns; one heading repeated has the values but not the sight."""
    two = TURNS[:2].as_quat()
    with pytest.raises(Refused, match="do not determine"):
        calibrate_by_source(amplitudes(errors)[:2], 5e-11, SOURCE, two, errors, ARRAY)
    same = np.repeat(POSES[:1], 12, axis=0)
    with pytest.raises(Refused, match="do not determine"):
        calibrate_by_source(np.repeat(amplitudes(errors)[:1], 12, axis=0), 5e-11, SOURCE, same, errors, ARRAY)
    with pytest.raises(InputError, match="shape"):
        calibrate_by_source(amplitudes(errors)[:5], 5e-11, SOURCE, POSES, errors, ARRAY)
    with pytest.raises(InputError, match="noise"):
        calibrate_by_source(amplitudes(errors), 0.0, SOURCE, POSES, errors, ARRAY)


def record(errors, rate_hz=100, seconds=4.0, noise_T=1e-10):
    """Return the recording of the coil in twelve headings, one after another, in the Earth's field."""
    generator = np.random.default_rng(63)
    count = round(rate_hz * seconds)
    time = np.arange(12 * count) / rate_hz
    pose = np.repeat(np.arange(12), count)
    carrier = np.sin(2 * np.pi * FREQUENCY_HZ * time + 0.3)[:, None, None]
    earth = TURNS.inv().apply([1e-6, 2e-5, -4.5e-5])
    steady = turned(errors, rotation_matrix(TRUTH.rotation))[0].distort(earth)
    readings = steady[pose] + carrier * amplitudes(errors)[pose] + noise_T * generator.normal(size=(len(time), 4, 3))
    return Recording(time, readings, attitude=POSES[pose])


def test_amplitudes_of_each_pose_come_out_of_a_recording(errors):
    """To their standard errors, each pose with one sign for all."""
    seen = amplitudes_of(record(errors), FREQUENCY_HZ)
    assert_allclose(seen.attitude, POSES)
    exact = amplitudes(errors)
    signs = np.sign(np.sum(seen.amplitudes_T * exact, axis=(1, 2)))[:, None, None]
    assert np.mean(((signs * seen.amplitudes_T - exact) / seen.noise_T) ** 2) == pytest.approx(1, abs=0.4)
    assert_allclose(seen.noise_T, 1e-10 * np.sqrt(2 / 400), rtol=0.2)


def test_recordings_that_show_no_poses_are_refused(errors):
    """Without attitude, or never at rest for ten periods."""
    recording = record(errors)
    with pytest.raises(InputError, match="no attitude"):
        amplitudes_of(replace(recording, attitude=None), FREQUENCY_HZ)
    with pytest.raises(InputError, match="stood still nowhere"):
        amplitudes_of(recording.take(slice(0, 50)), FREQUENCY_HZ)


@pytest.fixture(scope="module")
def calibration(scenario):
    """Return a calibration in a uniform field, whose frame is that of sensor 1."""
    return maximum_likelihood(simulate(scenario).recording, scenario.array)


@pytest.fixture(scope="module")
def completed(calibration, errors):
    """Return it completed by the source."""
    return complete(calibration, record(errors), SOURCE, FREQUENCY_HZ)


def test_completed_calibration_reads_field_and_gradient_near_a_source(calibration, completed, errors):
    """What baselines, frame and places of the axes made wrong by per cents is as of an error-free array."""
    other = Dipole(np.array([-1.5, 1.0, 0.8]), np.array([150.0, 100.0, -200.0]))
    rows, places = errors.matrix @ rotation_matrix(TRUTH.rotation), TRUTH.array_of(ARRAY).element_positions_m
    raw = np.einsum("kai,kai->ka", rows, other.field_T(places))[None] + errors.bias_T
    perfect = replace(ARRAY, positions_m=0.95 * ARRAY.positions_m)
    tensor = (perfect.operator @ other.field_T(perfect.positions_m).ravel())[3:]
    errors_of_tensor = [np.abs(one.apply(raw)[0, 3:] - tensor).max() for one in (calibration, completed)]
    assert errors_of_tensor[0] > 0.05 * np.abs(tensor).max()
    # What is left is the bend of the field over the places of the axes, which a fit of the dipole knows.
    assert errors_of_tensor[1] < 0.015 * np.abs(tensor).max()
    found = locate_each(Samples(completed.apply(raw), completed.array, completed.output_covariance))
    # Its axes are turned by 1.5° against the array: each sees a fiftieth of the field where another one's element is.
    assert_allclose(found.position_m[0], other.position_m, atol=6e-3)
    assert completed.known_source.baseline_scale == pytest.approx(0.95, abs=1e-4)
    assert completed.known_source.reduced_chi_square < 2
    assert "known place" in completed.frame


def test_covariance_turns_with_the_frame(calibration, completed):
    """To what was not known of the field comes the common rotation, to the source's precision."""
    before, after = (np.sum(one.output_standard_errors[:3] ** 2) for one in (calibration, completed))
    rotation = np.sum(completed.known_source.rotation_standard_errors**2) * 2 / 3 * calibration.intensity_T**2
    assert_allclose(after, before + rotation, rtol=0.02)
    turned = completed.standard_errors[0, 9:]
    assert_allclose(turned, completed.known_source.rotation_standard_errors, rtol=0.3)
    assert (calibration.standard_errors[0, 9:] == 0).all()


def test_covariance_of_the_outputs_is_that_of_noise_and_calibration(calibration):
    """Repeated readings of one field scatter by its noise part; its diagonal are the standard errors that are told."""
    certain = replace(calibration, covariance=np.zeros_like(calibration.covariance))
    noise = 1e-10 * np.random.default_rng(64).normal(size=(20_000, 4, 3))
    scatter, told = np.cov(certain.apply(noise).T), certain.output_covariance
    size = np.sqrt(np.diag(told))
    assert_allclose(scatter / np.outer(size, size), told / np.outer(size, size), atol=0.03)
    assert_allclose(np.sqrt(np.diag(calibration.output_covariance)), calibration.output_standard_errors)
    assert np.linalg.eigvalsh(calibration.output_covariance - told).min() > -1e-30


def test_completed_calibration_is_kept_in_its_file(calibration, completed):
    """Array, places of the axes, frame, and what the source showed, with standard errors."""
    again = calibration_from_yaml(calibration_to_yaml(completed), "here")
    assert_allclose(again.array.element_positions_m, completed.array.element_positions_m, rtol=0, atol=0)
    assert_allclose(again.correction_matrix, completed.correction_matrix, rtol=1e-12)
    assert_allclose(again.known_source.rotation, completed.known_source.rotation, rtol=1e-14)
    assert again.known_source.axis_offsets_standard_errors_m.shape == (4, 3, 3)
    assert again.frame == completed.frame
    assert again.is_of(calibration.array) and again.is_of(completed.array)
    assert not again.is_of(Array.cross(0.5)) and not calibration.is_of(completed.array)
    assert calibration_from_yaml(calibration_to_yaml(calibration), "here").known_source is None


@pytest.mark.parametrize("distance", [0.02, 0.2])
def test_another_source_than_stated_is_refused(calibration, errors, distance):
    """A coil that is stated away from where it is leaves residuals that noise cannot make."""
    moved = replace(SOURCE, position_m=SOURCE.position_m + distance)
    with pytest.raises(Refused, match="stated source"):
        complete(calibration, record(errors), moved, FREQUENCY_HZ)
