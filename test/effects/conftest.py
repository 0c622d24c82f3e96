"""What a model with the true errors leaves of a simulated recording."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.linalg import inv, norm
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.residuals import WhitenedResiduals
from tam_calibration.model.array import Array
from tam_calibration.model.fitted_effect import Contribution, FittedEffect
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors

NOISE_T = 1e-9
SCALAR_NOISE_T = 0.1e-9
INTENSITY_T = 50e-6


def residuals_of(recording, array, errors, intensity_T=INTENSITY_T, is_counted=None):
    """Return the whitened channels: the orthonormal complement of the stacked, weighted matrices, and the scalar."""
    count = recording.sensor_count
    weight = 1 / np.repeat(array.vector_noise_T, 3)
    stacked = weight[:, None] * errors.matrix.reshape(-1, 3)
    complement = np.linalg.svd(stacked)[0][:, 3:]
    covariance = inv(stacked.T @ stacked)
    rows = (recording.readings_T - errors.bias_T).reshape(-1, 3 * count)
    estimate = covariance @ stacked.T @ np.diag(weight)
    field = rows @ estimate.T
    direction = field / norm(field, axis=1)[:, None]
    scalar = np.full(len(rows), intensity_T) if recording.scalar_T is None else recording.scalar_T
    noise = (array.scalar_noise_T or 0.0) ** 2 + np.einsum("ni,ij,nj->n", direction, covariance, direction)
    slope = np.column_stack([-direction @ estimate, np.ones(len(rows))]) / np.sqrt(noise)[:, None]
    directions = weight[:, None] * complement
    common = (scalar - norm(field, axis=1)) / np.sqrt(noise)
    return WhitenedResiduals(
        recording,
        Covariates(recording.time_s, field, errors, array, recording.temperature_C, recording.current_A),
        rows @ directions,
        directions,
        common,
        slope,
        3 * count - 3 + np.isfinite(common),
        np.ones(len(rows), dtype=bool) if is_counted is None else is_counted,
    )


@dataclass(frozen=True, eq=False)
class Bench:
    """A simulated array whose rows can be disturbed in front of the residuals of the true errors."""

    covariates: Covariates
    rows_T: np.ndarray
    has_scalar: bool

    @property
    def generator(self):
        """Random numbers for what is added."""
        return np.random.default_rng(99)

    def with_effect(self, effect, *contributions):
        """Return the bench with an effect added to its rows."""
        fitted = FittedEffect(effect.name, {}, contributions)
        return self.with_rows(effect.add(self.rows_T, self.covariates, fitted, self.generator))

    def with_rows(self, rows_T):
        """Return the bench with other rows."""
        return Bench(self.covariates, rows_T, self.has_scalar)

    def residuals(self, is_counted=None):
        """Return what the true errors leave."""
        covariates = self.covariates
        readings = self.rows_T[:, :-1].reshape(covariates.sample_count, -1, 3)
        scalar = self.rows_T[:, -1] if self.has_scalar else None
        recording = Recording(covariates.time_s, readings, scalar)
        return residuals_of(recording, covariates.array, covariates.errors, is_counted=is_counted)


def make_bench(samples=2000, sensors=4, has_scalar=True, moves=True, seed=1, sheet=1.0, noise_T=NOISE_T):
    """Return a bench of an array that tumbles, or rests in random poses, with noise that the data sheet has so much."""
    generator = np.random.default_rng(seed)
    angle = np.radians(generator.uniform(-0.5, 0.5, (2, sensors, 3)))
    scale, bias = 1 + generator.uniform(-0.05, 0.05, (sensors, 3)), generator.uniform(-4e-8, 4e-8, (sensors, 3))
    errors = SensorErrors(scale, angle[0], bias, angle[1])
    positions = 0.3 * generator.normal(size=(sensors, 3))
    array = Array(positions, np.full(sensors, noise_T / sheet), SCALAR_NOISE_T)
    time = np.arange(samples) / 10
    if moves:
        turn = np.cumsum(generator.uniform(0.5, 1.5, 3))
        polar, azimuth = np.cos(0.11 * turn[0] * time), 0.37 * turn[1] * time
        level = np.sqrt(1 - polar**2)
        direction = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), polar], axis=1)
    else:
        direction = generator.normal(size=(samples, 3))
        direction /= norm(direction, axis=1)[:, None]
    field = INTENSITY_T * direction
    covariates = Covariates(time, field, errors, array)
    rows = np.empty((samples, 3 * sensors + 1))
    rows[:, :-1] = errors.distort(field).reshape(samples, -1) + generator.normal(0, noise_T, (samples, 3 * sensors))
    rows[:, -1] = INTENSITY_T + generator.normal(0, SCALAR_NOISE_T, samples)
    return Bench(covariates, rows, has_scalar)


@pytest.fixture
def bench():
    """Return the maker of benches."""
    return make_bench


@pytest.fixture(scope="session")
def turning():
    """Return the maker of covariates of a cross that tumbles for a minute, or as long as asked, with all channels."""
    return make_turning


def make_turning(samples=1200, step_s=0.05, sensors=4, start_s=0.0, attitude=None):
    """Return covariates whose field is known exactly; temperature and current vary."""
    generator = np.random.default_rng(5)
    time = start_s + step_s * np.arange(samples)
    phase = time - start_s
    if attitude is None:
        attitude = Rotation.from_euler("XYZ", np.outer(phase, [0.9, 0.55, 0.35])).as_quat()
    field = Rotation.from_quat(attitude).inv().apply([12e-6, 18e-6, -45e-6])
    turned = np.radians(generator.uniform(-1, 1, (2, sensors, 3)))
    bias = generator.uniform(-4e-8, 4e-8, (sensors, 3))
    errors = SensorErrors(1 + generator.uniform(-0.02, 0.02, (sensors, 3)), turned[0], bias, turned[1])
    cross = Array.cross(0.5).positions_m[:sensors]
    array = Array(cross, np.full(sensors, NOISE_T), SCALAR_NOISE_T, np.array([0.1, 0.2, 0.4]))
    temperature = 20 + 3 * np.sin(0.31 * phase) + np.sin(1.7 * phase)
    current = 2.0 * (np.sin(0.83 * phase) > 0.2) + 0.2 * np.sin(2.1 * phase)
    return Covariates(time, field, errors, array, temperature, current, attitude)


@pytest.fixture(scope="session")
def slew():
    """Return an amplifier that is too slow for the fastest change of the fourth row."""
    return Slew()


class Slew:
    """A fourth row that falls behind where it changes fastest, and catches up."""

    name = "slew"

    def add(self, rows_T, covariates, fitted, generator):
        """Return the rows with up to 12 nT less over five samples."""
        rows, middle = rows_T.copy(), int(np.argmax(np.abs(np.diff(covariates.sensed_T[:, 3]))))
        rows[middle - 2 : middle + 3, 3] -= np.array([4e-9, 8e-9, 12e-9, 12e-9, 5e-9])
        return rows


@pytest.fixture(scope="session")
def refitted():
    """Return the regression of an effect's own signal, with noise and the calibration as nuisance."""
    return refit


def refit(effect, covariates, shape, *terms):
    """Return the deviations of coefficients found by regression in their standard errors, and the relative errors.

    Coefficients of the terms, given as (sensor, axis, name), are drawn so that each adds some ten times the noise.
    """
    found = {(term.sensor, term.axis, term.name): term for term in effect.terms(covariates, shape)}
    generator = np.random.default_rng(8)
    row_count = covariates.scalar_row + 1
    blocks, truth, contributions = [], [], []
    for key in terms:
        term = found[key]
        values = []
        for one in np.eye(len(term.coefficients)):
            block = term.signal(one, row_count)
            values.append(10 * NOISE_T / np.abs(block).max() * generator.choice([-1.0, 1.0]))
            blocks.append(block.ravel())
        truth += values
        names = [coefficient.name for coefficient in term.coefficients]
        contributions.append(Contribution(*key, dict(zip(names, values, strict=True))))
    fitted = FittedEffect(effect.name, shape, tuple(contributions))
    clean = np.zeros((covariates.sample_count, row_count))
    added = effect.add(clean, covariates, fitted, generator)
    assert_allclose(added.ravel(), np.column_stack(blocks) @ truth, atol=1e-20)
    observed = added + NOISE_T * generator.normal(size=added.shape)
    nuisance = np.kron(
        np.column_stack([np.ones(covariates.sample_count), covariates.field_T / INTENSITY_T]), np.eye(row_count)
    )
    nuisance = nuisance.reshape(covariates.sample_count * row_count, -1)
    size = np.max(np.abs(blocks), axis=1)
    design = np.column_stack([np.transpose(blocks) / size, nuisance])
    covariance = np.linalg.pinv(design.T @ design, hermitian=True)
    step = (covariance @ design.T @ observed.ravel())[: len(size)] / size
    error = NOISE_T * np.sqrt(np.diag(covariance)[: len(size)]) / size
    return (step - truth) / error, np.abs(error / truth)


@pytest.fixture(scope="session")
def left_by():
    """Return the maker of the residuals that an effect leaves, with noise, under the true errors."""
    return make_left_by


def make_left_by(effect, covariates, shape, *contributions, seed=6):
    """Return what the true errors leave of readings with an effect; contributions are (sensor, axis, term, values)."""
    generator = np.random.default_rng(seed)
    fitted = FittedEffect(effect.name, shape, tuple(Contribution(*contribution) for contribution in contributions))
    rows = np.column_stack([covariates.sensed_T + covariates.errors.bias_T.ravel(), covariates.intensity_T])
    rows = effect.add(rows, covariates, fitted, generator)
    rows[:, :-1] += NOISE_T * generator.normal(size=rows[:, :-1].shape)
    rows[:, -1] += SCALAR_NOISE_T * generator.normal(size=len(rows))
    readings = rows[:, :-1].reshape(covariates.sample_count, -1, 3)
    return residuals_of(Recording(covariates.time_s, readings, rows[:, -1]), covariates.array, covariates.errors)
