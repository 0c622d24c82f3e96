"""Wu 2025 section 4.1: sweeps over σ_VM, σ_SM and N, Figs. 4 to 9, and two ways to turn the array."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from numpy.linalg import inv, norm
from scipy.spatial.transform import Rotation

from tam_calibration.fit import ellipsoid
from tam_calibration.fit.moments import field_products, gather, procrustes
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_nanotesla, to_nanotesla
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation.conditions import Motion, RandomEulerAngles, ThreeAxisTurns

RUNS = 50
"""Monte Carlo experiments of each point, as the paper has them."""
BASELINE_M = 0.5
DRIFT_NT = 8.26
_SWINGS = 3

GROUPS = {
    "scale factor errors": slice(0, 12),
    "non-orthogonality": slice(12, 24),
    "bias": slice(24, 36),
    "misalignment": slice(36, 45),
}
"""Columns of the 45 parameters that a uniform field determines."""


@dataclass(frozen=True)
class TurnsInAGrid:
    """Ten turns about z, six about y and six about x, one in the other: another reading of "in turn"."""

    def attitudes(self, time_s: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Return the quaternions (360, 4)."""
        steps = [2 * np.pi * np.arange(count) / count for count in (10, 6, 6)]
        angles = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3)
        return np.asarray(Rotation.from_euler("ZYX", angles).as_quat())


@dataclass(frozen=True)
class Setting:
    """What is simulated at a point of a sweep.

    Parameters
    ----------
    samples : int
    vector_nT, scalar_nT : float
        Standard deviations of the noise of an axis and of the scalar magnetometer.
    one_draw : bool
        Whether the scalar's noise is one draw for the whole data set.
    drifts : bool
        Whether the field swings by 8.26 nT, which the scalar magnetometer reads.
    motion : Motion
    """

    samples: int = 360
    vector_nT: float = 1.0
    scalar_nT: float = 0.0
    one_draw: bool = False
    drifts: bool = False
    motion: Motion = field(default_factory=RandomEulerAngles)


@dataclass(frozen=True, eq=False)
class Sweep:
    """What is swept, over which values, with which settings."""

    symbol: str
    unit: str
    points: Sequence[float]
    settings: Sequence[Setting]


_USUAL = Setting()
_VECTOR_NOISE_NT = (0.1, 0.2, 0.5, 1, 2, 5, 10)
_SCALAR_NOISE_NT = (0.01, 0.03, 0.1, 0.3, 1, 3, 10)
_SAMPLES = (60, 90, 180, 360, 720, 1440, 2880)
SWEEPS = {
    "noise of the sensors": Sweep(
        "σ_VM", "nT", _VECTOR_NOISE_NT, [Setting(vector_nT=noise) for noise in _VECTOR_NOISE_NT]
    ),
    "scalar noise, one draw per data set": Sweep(
        "σ_SM", "nT", _SCALAR_NOISE_NT, [Setting(scalar_nT=noise, one_draw=True) for noise in _SCALAR_NOISE_NT]
    ),
    "scalar noise, one draw per sample": Sweep(
        "σ_SM", "nT", _SCALAR_NOISE_NT, [Setting(scalar_nT=noise) for noise in _SCALAR_NOISE_NT]
    ),
    "number of samples": Sweep("N", "", _SAMPLES, [Setting(samples=count) for count in _SAMPLES]),
    "drift of the field": Sweep("drift", "nT", (0, DRIFT_NT), [_USUAL, replace(_USUAL, drifts=True)]),
    "turns": Sweep(
        "way", "", (0, 1, 2), [_USUAL, replace(_USUAL, motion=ThreeAxisTurns()), replace(_USUAL, motion=TurnsInAGrid())]
    ),
}


@dataclass(frozen=True, eq=False)
class Point:
    """Means over the runs of a setting.

    Parameters
    ----------
    relative : (4,) array
        Relative errors of ``GROUPS``.
    scatter : (2,) array
        Standard deviations over the runs of the mean relative error, and of e_B before.
    bias_rmse_T : float
    before, after : (5,) array
        e_B of the four sensors (Wu 2025 eqs. 14 and 15, against the true intensity, nT) and e_T (eqs. 16 and 17, nT/m).
    """

    relative: FloatArray
    scatter: FloatArray
    bias_rmse_T: float
    before: FloatArray
    after: FloatArray


@cache
def _site() -> tuple[SensorErrors, FloatArray]:
    """Return the errors of Table 1 and the field (3,) of the site."""
    scenario = read_scenario("wu_table_1")
    return scenario.errors, scenario.site_field_T


def run_point(setting: Setting, seed: int, as_published: bool) -> Point:
    """Return the means over the runs of a setting; the runs of different settings share their random numbers."""
    relative, bias, before, after = zip(
        *(_run(setting, [seed, number], as_published) for number in range(RUNS)), strict=True
    )
    errors = np.array(relative)
    means = np.stack([errors[:, columns].mean(axis=1) for columns in GROUPS.values()], axis=1)
    raw = np.array(before)
    return Point(
        means.mean(axis=0),
        np.array([errors.mean(axis=1).std(), raw[:, :4].mean(axis=1).std()]),
        float(np.sqrt(np.mean(np.square(bias)))),
        raw.mean(axis=0),
        np.mean(after, axis=0),
    )


def _run(
    setting: Setting, seed: list[int], as_published: bool
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the (45,) relative errors, those of the biases (12,) in tesla, and (5,) residuals before and after."""
    errors, site = _site()
    generator = np.random.default_rng(seed)
    time_s = np.arange(setting.samples, dtype=float)
    turns = Rotation.from_quat(setting.motion.attitudes(time_s, generator)).inv()
    intensity = norm(site) + np.zeros(setting.samples)
    if setting.drifts:
        phase = 2 * np.pi * _SWINGS * time_s / setting.samples
        intensity += np.sqrt(2) * from_nanotesla(DRIFT_NT) * np.sin(phase)
    seen = turns.apply(site) * (intensity / norm(site))[:, None]
    noise = from_nanotesla(setting.vector_nT) * generator.normal(size=(setting.samples, 4, 3))
    scalar_noise = generator.normal(size=1 if setting.one_draw else setting.samples)
    readings = errors.distort(seen) + noise
    recording = Recording(time_s, readings, intensity + from_nanotesla(setting.scalar_nT) * scalar_noise)
    found = published_errors(recording, as_published)
    truth, estimate = (_determined(each.to_vector()) for each in (errors, found))
    size = np.abs(truth - np.repeat([1.0, 0.0], [12, 33]))
    bias = (estimate - truth)[GROUPS["bias"]]
    return (
        np.abs(estimate - truth) / size,
        bias,
        residuals_nT(readings, intensity, BASELINE_M),
        residuals_nT(found.restore(readings), intensity, BASELINE_M),
    )


def published_errors(recording: Recording, as_published: bool) -> SensorErrors:
    """Return the errors by the three steps of Wu 2025, without covariance.

    Parameters
    ----------
    recording : Recording
        Samples in a uniform field.
    as_published : bool
        Step 1 as printed, with a constant intensity; otherwise it follows the scalar.
    """
    moments = gather(recording, "lossless", groups=1)
    center = ellipsoid.center_of((moments.with_constant_intensity() if as_published else moments).quartic)
    unmix = ellipsoid.square_root(ellipsoid.shape_about(moments.quartic, center))
    matrix = inv(unmix) @ procrustes(field_products(moments.joint, unmix, center)[:, :, 0])
    return moments.data.errors_at(matrix[0], center[0])[0]


def residuals_nT(fields_T: FloatArray, intensity_T: FloatArray, baseline_m: float) -> FloatArray:
    """Return e_B of the four sensors, nT, and e_T, nT/m, of fields (N, 4, 3) in a uniform field."""
    sensors = np.sqrt(np.mean((norm(fields_T, axis=2) - intensity_T[:, None]) ** 2, axis=0))
    along_x, along_y = fields_T[:, 0] - fields_T[:, 2], fields_T[:, 1] - fields_T[:, 3]
    mixed = (along_x[:, 1] + along_y[:, 0]) / 2
    components = np.stack([along_x[:, 0], along_y[:, 1], mixed, along_y[:, 2], along_x[:, 2]])
    tensor = np.sqrt(np.mean(np.sum(components**2, axis=0))) / baseline_m
    return to_nanotesla(np.append(sensors, tensor))


def _determined(table: FloatArray) -> FloatArray:
    """Return the (45,) values of a table (4, 12) by kind, without the misalignment of sensor 1."""
    kinds: FloatArray = table.reshape(4, 4, 3).transpose(1, 0, 2).ravel()
    return np.delete(kinds, np.s_[36:39])
