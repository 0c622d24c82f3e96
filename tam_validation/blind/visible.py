"""The visible part of a disturbance, in noise floors, and the amplitude for a wanted gap."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.linalg import norm, pinv, qr, svd

from tam_calibration.model.units import FloatArray
from tam_validation.blind.disturbance import Disturbance, Signal
from tam_validation.blind.scene import Scene

_CONSTANCY = 0.02
"""Standard deviation of the constant intensity that replaces a scalar, over the vectors' noise."""


@dataclass(frozen=True, eq=False)
class NominalModel:
    """The nominal model about its true parameters: reading = matrix · field + offset, scalar = |field|.

    The unknowns are the field of each sample, the first sensor's upper triangle, the others' matrices and all
    offsets: 45 for the cross.
    """

    scene: Scene

    @property
    def channels(self) -> int:
        """Redundant channels of a sample: what is read less the three of the field."""
        return 3 * self.scene.sensor_count - 2

    @cached_property
    def weights(self) -> FloatArray:
        """One over the noise of what is read, sensor by sensor, the scalar last (3K + 1,)."""
        scene = self.scene
        scalar = scene.scalar_noise_T if scene.with_scalar else _CONSTANCY * scene.vector_noise_T
        return 1 / np.append(np.full(3 * scene.sensor_count, scene.vector_noise_T), scalar)

    @cached_property
    def field_directions(self) -> FloatArray:
        """Derivatives by each sample's field, orthonormal and whitened (N, 3K + 1, 3)."""
        scene = self.scene
        samples, sensors = scene.sample_count, scene.sensor_count
        vectors = np.broadcast_to(scene.response.reshape(1, 3 * sensors, 3), (samples, 3 * sensors, 3))
        along = (scene.field_T / norm(scene.field_T, axis=1)[:, None])[:, None, :]
        return np.asarray(qr(np.concatenate([vectors, along], axis=1) * self.weights[:, None])[0])

    @cached_property
    def tangent(self) -> FloatArray:
        """Derivatives by the parameters, fields projected out, whitened, columns of unit size (N (3K + 1), p)."""
        scene = self.scene
        of_parameters = [(row, column) for row in range(3 * scene.sensor_count) for column in range(4)]
        rows, columns = np.array([(row, column) for row, column in of_parameters if row > 2 or column >= row]).T
        unit = np.column_stack([scene.field_T / scene.intensity_T.mean(), np.ones(scene.sample_count)])
        directions = self.field_directions
        across = np.eye(directions.shape[1]) - directions @ np.swapaxes(directions, 1, 2)
        stacked = (across[:, :, rows] * unit[:, None, columns]).reshape(-1, len(rows))
        return np.asarray(stacked / norm(stacked, axis=0))

    @cached_property
    def conditioning(self) -> float:
        """Smallest singular value of the tangent over its largest; near zero for an uninformative motion."""
        values = svd(self._normal, compute_uv=False)
        return float(np.sqrt(max(values[-1], 0) / values[0]))

    @cached_property
    def _normal(self) -> FloatArray:
        return np.asarray(self.tangent.T @ self.tangent)

    @cached_property
    def _inverse(self) -> FloatArray:
        return pinv(self._normal, hermitian=True)

    def _without_fields(self, whitened: FloatArray) -> FloatArray:
        directions = self.field_directions
        along = np.swapaxes(directions, 1, 2) @ whitened[..., None]
        return np.asarray(whitened - (directions @ along)[..., 0])

    def whitened(self, signal: Signal) -> FloatArray:
        """Return the residual of a signal with every sample's field free (N, 3K + 1)."""
        vectors, scalar = signal
        if not self.scene.with_scalar:
            scalar = np.zeros_like(scalar)
        rows = np.concatenate([vectors.reshape(len(vectors), -1), scalar[:, None]], axis=1) * self.weights
        return self._without_fields(rows)

    def left(self, signal: Signal) -> FloatArray:
        """Return the residual of a signal after the nominal fit, in noise floors (N, 3K + 1)."""
        rows = self.whitened(signal)
        left = rows.ravel()
        for _ in range(2):  # the second time takes off what rounding of the normal matrix left
            left = left - self.tangent @ (self._inverse @ (left @ self.tangent))
        return left.reshape(rows.shape)

    def visible_gap(self, signal: Signal) -> float:
        """Return the root mean square of that residual over the redundant channels."""
        left = self.left(signal)
        return float(np.sqrt((left**2).sum() / (len(left) * self.channels)))


_NEAR = 0.01
"""Share by which the gap may differ from the one wanted."""

_STEPS = 60


@dataclass(frozen=True, eq=False)
class Scaled:
    """A disturbance at an amplitude, with its signal and visible gap."""

    disturbance: Disturbance
    amplitude: float
    signal: Signal
    visible_gap: float


def scale_to(model: NominalModel, disturbance: Disturbance, gap: float, seen: Signal) -> Scaled | None:
    """Return the disturbance at the amplitude that has a wanted visible gap; None when none has.

    The gap grows with the amplitude, for most in proportion; the search stays within the known bracket.
    """
    low, high, amplitude = 0.0, np.inf, _start(model, disturbance)
    for _ in range(_STEPS):
        signal = disturbance.change(amplitude, seen)
        visible = model.visible_gap(signal)
        if abs(visible / gap - 1) < _NEAR:
            return Scaled(disturbance, amplitude, signal, visible)
        low, high = (amplitude, high) if visible < gap else (low, amplitude)
        guess = amplitude * (np.clip(gap / visible, 0.1, 10) if visible > 0 else 10)
        inside = low < guess < high
        amplitude = float(guess if inside else np.sqrt(max(low, high * 1e-3) * high))
        if high < low * (1 + 1e-9) or not np.isfinite(amplitude):
            break
    return None


def _start(model: NominalModel, disturbance: Disturbance) -> float:
    """Return an amplitude to begin with: the noise for what is in tesla, the natural one for the rest."""
    if disturbance.amplitude_unit.startswith("T "):
        return model.scene.vector_noise_T
    return 1e-4 if disturbance.amplitude_unit.startswith("rad") else 1.0 if "nT" in disturbance.amplitude_unit else 1e-3
