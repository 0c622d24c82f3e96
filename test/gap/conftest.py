"""Runs of an array in a uniform field with a known truth, and their whitened channels built densely."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.linalg import inv, norm
from scipy.spatial.transform import Rotation

from tam_calibration.effects.term import chosen
from tam_calibration.gap.hypothesis import Part
from tam_calibration.gap.model import Model
from tam_calibration.gap.regressors import World
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors

FIELD_T = np.array([12e-6, 18e-6, -45e-6])
NOISE_T, SCALAR_NOISE_T = 1e-9, 2e-10


@dataclass(frozen=True, eq=False)
class Run:
    """A recording, the array as its data sheet has it, the true errors and the true intensity."""

    recording: Recording
    array: KnownNoiseArray
    errors: SensorErrors
    intensity_T: float

    @property
    def row_count(self):
        """The number of rows, 3 K + 1."""
        return 3 * self.array.sensor_count + 1

    def with_added(self, added_T):
        """Return the run with something added to its rows (N, 3K + 1)."""
        recording = self.recording
        readings = recording.readings_T + added_T[:, :-1].reshape(recording.readings_T.shape)
        scalar = None if recording.scalar_T is None else recording.scalar_T + added_T[:, -1]
        return replace(self, recording=replace(recording, readings_T=readings, scalar_T=scalar))

    def with_row(self, row, signal_T):
        """Return the run with a signal (N,) added to one row."""
        added = np.zeros((self.recording.sample_count, self.row_count))
        added[:, row] = signal_T
        return self.with_added(added)

    def channels(self, **options):
        """Return the channels at the true errors."""
        return WhitenedChannels.at(self.recording, self.array, self.errors, self.intensity_T, **options)

    def model(self, **options):
        """Return the model with the calibration fitted."""
        return Model(self.recording, self.array, self.errors, self.intensity_T, **options).settled()


def make_run(samples=600, sensors=4, has_scalar=True, seed=1, sheet=1.0, noise_T=NOISE_T):
    """Return a run of an array that tumbles for a minute, with all channels; its noise is so many times the sheet's."""
    generator = np.random.default_rng(seed)
    time = np.linspace(0, 60, samples)
    attitude = Rotation.from_euler("XYZ", np.outer(time, [0.9, 0.55, 0.35]))
    field = attitude.inv().apply(FIELD_T)
    turned = np.radians(generator.uniform(-1, 1, (2, sensors, 3)))
    turned[1, 0] = 0
    bias = generator.uniform(-4e-8, 4e-8, (sensors, 3))
    errors = SensorErrors(1 + generator.uniform(-0.02, 0.02, (sensors, 3)), turned[0], bias, turned[1])
    positions = Array.cross(0.5).positions_m if sensors == 4 else generator.uniform(-0.3, 0.3, (sensors, 3))
    array = KnownNoiseArray(positions, np.full(sensors, noise_T / sheet), SCALAR_NOISE_T / sheet if has_scalar else 0.0)
    intensity = float(norm(FIELD_T))
    recording = Recording(
        time,
        errors.distort(field) + noise_T * generator.normal(size=(samples, sensors, 3)),
        intensity + SCALAR_NOISE_T * generator.normal(size=samples) if has_scalar else None,
        20 + 3 * np.sin(0.31 * time) + np.sin(1.7 * time),
        2.0 * (np.sin(0.83 * time) > 0.2) + 0.2 * np.sin(2.1 * time),
        attitude.as_quat(),
    )
    return Run(recording, array, errors, intensity)


@pytest.fixture(scope="session")
def run():
    """Return the maker of runs."""
    return make_run


def accept_terms(model, effect, fitted):
    """Return a model with one more effect, in the shape and the terms of a fitted one."""
    keys = tuple((one.sensor, one.axis, one.term) for one in fitted.contributions)
    terms = chosen(effect.terms(model.channels().covariates, fitted.shape), keys)
    part = Part(effect, fitted.shape, keys, np.zeros(sum(len(term.coefficients) for term in terms)))
    return replace(model, parts=(*model.parts, part)).settled()


@pytest.fixture(scope="session")
def accepted():
    """Return what accepts an effect."""
    return accept_terms


@dataclass(frozen=True, eq=False)
class Dense:
    """Whitened channels as a list: residuals (N, C) and how a shift of each row moves them (N, C, 3K + 1)."""

    residual: np.ndarray
    slope: np.ndarray

    def design(self, features, index, rows, columns, width):
        """Return the whitened columns (N, C, P) of atoms."""
        matrix = np.zeros((*self.residual.shape, width))
        parts = rows if rows.ndim == 2 else np.eye(self.slope.shape[2])[rows]
        for atom, part, column in zip(index, parts, columns, strict=True):
            matrix[:, :, column] += features[:, atom, None] * (self.slope @ part)
        return matrix

    def of(self, design):
        """Return the whitened columns of a ``Design``."""
        return self.design(design.features, design.index, design.rows, design.columns, design.width)

    def take(self, samples):
        """Return the channels of some samples."""
        return Dense(self.residual[samples], self.slope[samples])

    def left(self, *designs):
        """Return the sum of squares that least squares leaves."""
        if not designs:
            return float(np.sum(self.residual**2))
        matrix = np.concatenate([self.of(design) for design in designs], axis=2).reshape(self.residual.size, -1)
        size = np.maximum(norm(matrix, axis=0), 1e-300)
        step = np.linalg.lstsq(matrix / size, self.residual.ravel(), rcond=1e-6)[0]
        return float(np.sum((self.residual.ravel() - matrix / size @ step) ** 2))


def make_dense(run):
    """Return the channels of a run at the true errors: the complement of the stacked matrices, and the scalar."""
    recording, array, errors = run.recording, run.array, run.errors
    weight = 1 / np.repeat(array.vector_noise_T, 3)
    stacked = weight[:, None] * errors.matrix.reshape(-1, 3)
    complement = np.linalg.svd(stacked)[0][:, 3:]
    covariance = inv(stacked.T @ stacked)
    unmix = covariance @ stacked.T * weight
    rows = (recording.readings_T - errors.bias_T).reshape(recording.sample_count, -1)
    field = rows @ unmix.T
    length = norm(field, axis=1)
    direction = field / length[:, None]
    scalar = np.full(len(rows), run.intensity_T) if recording.scalar_T is None else recording.scalar_T
    deviation = np.sqrt((array.scalar_noise_T or 0) ** 2 + np.sum(direction @ covariance * direction, axis=1))
    residual = np.column_stack([rows * weight @ complement, np.nan_to_num((scalar - length) / deviation)])
    slope = np.zeros((len(rows), residual.shape[1], rows.shape[1] + 1))
    slope[:, :-1, :-1] = (weight[:, None] * complement).T
    slope[:, -1, :-1] = -direction @ unmix
    slope[:, -1, -1] = 1
    slope[:, -1] *= (np.isfinite(scalar) / deviation)[:, None]
    return Dense(residual, slope)


@pytest.fixture(scope="session")
def dense():
    """Return the maker of dense channels."""
    return make_dense


@dataclass(frozen=True, eq=False)
class Lone:
    """A recording of one sensor with attitude and without scalar, its array, the true errors, world and field."""

    recording: Recording
    array: KnownNoiseArray
    errors: SensorErrors
    world: World
    field_T: np.ndarray

    def channels(self, **options):
        """Return the channels at the truth."""
        return WhitenedChannels.at(
            self.recording, self.array, self.errors, self.world.intensity_T, world=self.world, **options
        )

    def with_added(self, added_T):
        """Return the same with something (N, 3) added to the readings."""
        return replace(self, recording=replace(self.recording, readings_T=self.recording.readings_T + added_T[:, None]))


def make_lone(samples=900, noise_T=NOISE_T, attitude_noise=0.0, seed=1):
    """Return a sensor that tumbles for a minute, a third of a turn apart from what records its attitude in radians."""
    generator = np.random.default_rng(seed)
    time = np.linspace(0, 60, samples)
    of_sensor = Rotation.from_euler("XYZ", np.outer(time, [0.9, 0.55, 0.35]))
    mount = Rotation.from_rotvec(2 * np.pi / 3 / np.sqrt(3) * np.array([1, 1, 1])) * Rotation.from_rotvec(
        [0, 0.05, 0.1]
    )
    field = of_sensor.inv().apply(FIELD_T)
    scale = np.array([[1.03, 0.99, 1.0]])
    scale /= np.cbrt(np.prod(scale))
    errors = SensorErrors(scale, np.zeros((1, 3)), np.array([[3e-7, -2e-7, 5e-7]]), np.zeros((1, 3)))
    readings = errors.distort(field) + noise_T * generator.normal(size=(samples, 1, 3))
    wrong = Rotation.from_rotvec(attitude_noise * generator.normal(size=(samples, 3)))
    recorded = (of_sensor * mount * wrong).as_quat()
    recording = Recording(time, readings, attitude=recorded)
    return Lone(
        recording,
        KnownNoiseArray(np.zeros((1, 3)), np.array([noise_T]), 0.0),
        errors,
        World(FIELD_T, mount.as_matrix()),
        field,
    )


@pytest.fixture(scope="session")
def lone():
    """Return the maker of runs of one sensor with attitude."""
    return make_lone
