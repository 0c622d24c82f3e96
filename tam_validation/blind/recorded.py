"""A real recording as the scene of a disturbance, and what a nominal model of its own leaves of what is added to it.

The fits are this check's own, as the effects are: an ellipsoid for each sensor, or a constant field that the recorded
attitude turns, both robust.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.linalg import qr
from numpy.random import Generator
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter
from scipy.stats import chi2

from tam_calibration.model.exceptions import Refused
from tam_calibration.model.units import FloatArray
from tam_validation.blind.continuous_motion import ContinuousMotion
from tam_validation.blind.disturbance import Signal
from tam_validation.blind.processes import draw_load, draw_weather
from tam_validation.blind.recorded_fit import Fit, fit_attitude, fit_ellipsoids
from tam_validation.blind.scene import Scene
from tam_validation.blind.visible import NominalModel

FEWEST = 60
"""Samples; fewer show neither the fit nor what it leaves."""

_SMOOTHED_S = 0.25
"""Within this time, a tenth of the quickest turn of a hand, a reading without attitude is taken to be a cubic."""

_ONE_NANOTESLA = 1e-9
"""Noise of the scene's sensors, so that its noise floors are nanoteslas: a real recording's own noise is not known."""


@dataclass(frozen=True, eq=False)
class Recorded:
    """What a real recording holds.

    Parameters
    ----------
    time_s : (N,) array
    readings_T : (N, K, 3) array
    scalar_T : (N,) array, optional
        NaN where the scalar magnetometer was not read.
    to_world : (N, 3, 3) array, optional
        Rotations from the array's frame to the world's.
    positions_m : (K, 3) array
        Of the sensors, in the array's frame.
    """

    time_s: FloatArray
    readings_T: FloatArray
    scalar_T: FloatArray | None
    to_world: FloatArray | None
    positions_m: FloatArray

    @cached_property
    def intensity_T(self) -> FloatArray | None:
        """Scalar (N,) on straight lines between its readings; None without any."""
        if self.scalar_T is None or not np.isfinite(self.scalar_T).any():
            return None
        known = np.isfinite(self.scalar_T)
        return np.interp(self.time_s, self.time_s[known], self.scalar_T[known])


@dataclass(frozen=True, eq=False)
class RecordedScene(Scene):
    """A scene whose undisturbed readings are those of a fit to a real recording; times from its first sample."""

    fit: Fit
    attitudes: FloatArray | None

    @cached_property
    def field_T(self) -> FloatArray:
        """Field (N, 3) in the array's frame, by the fit."""
        return self.fit.field_T

    @cached_property
    def to_world(self) -> FloatArray:
        """Recorded rotations (N, 3, 3).

        Raises
        ------
        Refused
            When none are recorded.
        """
        if self.attitudes is None:
            raise Refused("the recording holds no attitude")
        return self.attitudes

    @cached_property
    def _waveform(self) -> CubicSpline:
        smooth = self.fit.readings_T
        if self.attitudes is None:
            window = 2 * int(_SMOOTHED_S / self.step_s / 2) + 1
            smooth = savgol_filter(smooth, window, 3, axis=0) if window > 3 else smooth
        return CubicSpline(self.time_s, smooth)

    def readings_at(self, time_s: FloatArray) -> FloatArray:
        """Return what the undisturbed sensors read (n, K, 3) at any time within the recording."""
        return np.asarray(self._waveform(np.clip(time_s, self.time_s[0], self.time_s[-1])))


@dataclass(frozen=True, eq=False)
class AttitudeModel(NominalModel):
    """The nominal model of sensors whose attitude is recorded: reading = matrix · turned constant field + offset.

    A scalar reads a constant.
    """

    scene: RecordedScene

    @property
    def channels(self) -> int:
        """Redundant channels of a sample: all that is read."""
        return 3 * self.scene.sensor_count + self.scene.with_scalar

    @cached_property
    def parameters(self) -> FloatArray:
        """What a change of the parameters does to a sample's readings, the scalar last, orthonormal (N channels, p)."""
        scene, vectors = self.scene, 3 * self.scene.sensor_count
        unit = np.column_stack([scene.field_T / scene.intensity_T.mean(), np.ones(scene.sample_count)])
        change = np.einsum("nc,rs->nrsc", unit, np.eye(vectors)).reshape(scene.sample_count, vectors, -1)
        turned = np.einsum("kij,nlj->nkil", scene.response, scene.to_world).reshape(len(change), vectors, 3)
        # One of the three directions of the field is its size, which the matrices hold already.
        field = np.einsum("nij,nj->ni", scene.to_world, scene.field_T).mean(axis=0)
        across = np.linalg.svd(field[None])[2][1:]
        columns = np.concatenate([change, turned @ across.T], axis=2)
        if scene.with_scalar:
            columns = np.pad(columns, ((0, 0), (0, 1), (0, 1)))
            columns[:, -1, -1] = 1
        return np.asarray(qr(columns.reshape(-1, columns.shape[2]))[0])

    def whitened(self, signal: Signal) -> FloatArray:
        """Return a signal in noise floors (N, channels)."""
        vectors, scalar = signal
        rows = np.column_stack([vectors.reshape(len(vectors), -1), scalar]) * self.weights
        return np.asarray(rows[:, : self.channels])

    def left(self, signal: Signal) -> FloatArray:
        """Return what the best nominal fit leaves of a signal, in noise floors (N, channels)."""
        rows = self.whitened(signal)
        return rows - (self.parameters @ (self.parameters.T @ rows.ravel())).reshape(rows.shape)


def model_of(scene: RecordedScene) -> NominalModel:
    """Return the nominal model that fits what is recorded."""
    return NominalModel(scene) if scene.attitudes is None else AttitudeModel(scene)


def own_residual(model: NominalModel, scene: RecordedScene, recorded: Recorded) -> float:
    """Return the robust root mean square over the redundant channels of what a recording leaves by itself."""
    scalar = np.zeros(scene.sample_count) if recorded.intensity_T is None else recorded.intensity_T - scene.intensity_T
    left = model.whitened((recorded.readings_T - scene.fit.readings_T, scalar - scalar.mean()))
    return float(np.sqrt(np.median((left**2).sum(axis=1)) / chi2.median(model.channels)))


def scene_of(rng: Generator, recorded: Recorded) -> RecordedScene:
    """Fit a recording, and make up a temperature and a current beside it.

    Raises
    ------
    Refused
        When there are too few samples, or no fit describes them.
    """
    time_s, readings_T, attitudes = recorded.time_s, recorded.readings_T, recorded.to_world
    if len(time_s) < FEWEST:
        raise Refused(f"the recording holds {len(time_s)} samples: an effect is put into {FEWEST} or more")
    since_s = time_s - time_s[0]
    duration_s = float(since_s[-1])
    scalar_T = recorded.intensity_T
    fit = fit_ellipsoids(readings_T, scalar_T) if attitudes is None else fit_attitude(readings_T, attitudes)
    return RecordedScene(
        time_s=since_s,
        duration_s=duration_s,
        step_s=float(np.median(np.diff(since_s))),
        motion=ContinuousMotion("recorded", lambda at_s: np.zeros((len(at_s), 3))),
        world_field=lambda at_s: np.zeros((len(at_s), 3)),
        positions_m=recorded.positions_m,
        response=fit.response,
        bias_T=fit.bias_T,
        vector_noise_T=_ONE_NANOTESLA,
        scalar_noise_T=_ONE_NANOTESLA,
        with_scalar=scalar_T is not None,
        channels=(),
        temperature=draw_weather(rng, duration_s),
        current=draw_load(rng, duration_s),
        fit=fit,
        attitudes=attitudes,
    )
