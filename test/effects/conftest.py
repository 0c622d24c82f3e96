"""What a model with the true errors leaves of a simulated recording."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.linalg import inv, norm

from tam_calibration.array import Array
from tam_calibration.effects.effect import FittedEffect, Misfit, Situation
from tam_calibration.errors import SensorErrors
from tam_calibration.recording import Recording

NOISE_T = 1e-9
SCALAR_NOISE_T = 0.1e-9
INTENSITY_T = 50e-6


def misfit_of(recording, array, errors, intensity_T=INTENSITY_T, is_counted=None):
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
    return Misfit(
        recording,
        Situation(recording.time_s, field, errors, array, recording.temperature_C, recording.current_A),
        rows @ directions,
        directions,
        common,
        slope,
        3 * count - 3 + np.isfinite(common),
        np.ones(len(rows), dtype=bool) if is_counted is None else is_counted,
    )


@dataclass(frozen=True, eq=False)
class Bench:
    """A simulated array whose rows can be disturbed in front of the misfit of the true errors."""

    situation: Situation
    rows_T: np.ndarray
    has_scalar: bool

    @property
    def generator(self):
        """Random numbers for what is added."""
        return np.random.default_rng(99)

    def with_effect(self, effect, *contributions):
        """Return the bench with an effect added to its rows."""
        fitted = FittedEffect(effect.name, {}, contributions)
        return self.with_rows(effect.add(self.rows_T, self.situation, fitted, self.generator))

    def with_rows(self, rows_T):
        """Return the bench with other rows."""
        return Bench(self.situation, rows_T, self.has_scalar)

    def misfit(self, is_counted=None):
        """Return what the true errors leave."""
        situation = self.situation
        readings = self.rows_T[:, :-1].reshape(situation.sample_count, -1, 3)
        scalar = self.rows_T[:, -1] if self.has_scalar else None
        recording = Recording(situation.time_s, readings, scalar)
        return misfit_of(recording, situation.array, situation.errors, is_counted=is_counted)


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
    situation = Situation(time, field, errors, array)
    rows = np.empty((samples, 3 * sensors + 1))
    rows[:, :-1] = errors.distort(field).reshape(samples, -1) + generator.normal(0, noise_T, (samples, 3 * sensors))
    rows[:, -1] = INTENSITY_T + generator.normal(0, SCALAR_NOISE_T, samples)
    return Bench(situation, rows, has_scalar)


@pytest.fixture
def bench():
    """Return the maker of benches."""
    return make_bench
