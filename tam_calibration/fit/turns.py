"""Which turn of a vehicle buys most certainty of tensor and centre field per minute, and what one has bought so far.

The standard errors of a turn are computed before it is fitted, and while its samples arrive.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from tam_calibration.fit.coverage import CELLS, Coverage, judge_coverage, measure_coverage
from tam_calibration.fit.ellipsoid import sphere_center
from tam_calibration.fit.gyroscope_path import GyroscopeState, GyroscopeUse
from tam_calibration.fit.information import inverted
from tam_calibration.fit.plan import field_directions, require_swings
from tam_calibration.fit.prior import Prior
from tam_calibration.fit.problem import Known, Place, Problem
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.data_sheet import Gyroscope
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_degrees


@dataclass(frozen=True)
class Vehicle:
    """What a vehicle can do, and how often its sensors are read.

    Parameters
    ----------
    pitch_limit, roll_limit : float
        Largest angles to either side, radians.
    turn_rate : float
        Largest rate about each axis, rad/s.
    sample_rate_hz : float
        Samples per second.

    Raises
    ------
    InputError
        When a limit or rate is none of a vehicle.
    """

    pitch_limit: float
    roll_limit: float
    turn_rate: float
    sample_rate_hz: float

    def __post_init__(self) -> None:
        """Check the values."""
        require_swings(self.pitch_limit, self.roll_limit)
        if not 0 < self.turn_rate <= np.pi:
            raise InputError("the turn rate must lie above 0 and up to 180 degrees per second")


@dataclass(frozen=True, eq=False)
class Turn:
    """A turn and what it buys.

    Parameters
    ----------
    yaw, pitch, roll : float
        Change of the heading, and swings to either side, radians.
    duration_s : float
        At the rates of the vehicle.
    excess : float
        What the uncertain calibration then adds to the variance of the outputs, as part of the noise: mean over the
        centre field, and over the tensor where the array sees it.
    gain_per_minute : float
        By how much that is less than before, per minute.
    """

    yaw: float
    pitch: float
    roll: float
    duration_s: float
    excess: float
    gain_per_minute: float


def excess_of(prior: Prior, covariance: FloatArray) -> float:
    """Return what a covariance of the errors adds to the variance of the outputs, as part of that of the noise.

    The mean over all outputs that the array determines, over all directions of the field.
    """
    calibration = prior.calibration
    with_errors = np.diag(replace(calibration, covariance=covariance).output_covariance)
    noise = np.diag(replace(calibration, covariance=np.zeros_like(covariance)).output_covariance)
    return float(np.nanmean(with_errors / noise)) - 1


def best_turns(prior: Prior, vehicle: Vehicle, inclination: float, gyroscope: Gyroscope | None = None) -> list[Turn]:
    """Return the turns that a vehicle can make, the one that buys most per minute first.

    Parameters
    ----------
    prior : Prior
        What is known now; it is linearised there.
    vehicle : Vehicle
        What it can do.
    inclination : float
        Of the field, positive downwards, radians.
    gyroscope : Gyroscope, optional
        What records the angular velocity of the turns; it counts where its noise is stated.
    """
    calibration, before = prior.calibration, excess_of(prior, prior.covariance)
    swings = [(0.0,) if limit == 0 else (0.0, limit) for limit in (vehicle.pitch_limit, vehicle.roll_limit)]
    turns = []
    # from_degrees(np.array([0.0, 90.0, 180.0, 360.0])): turns of the heading that are compared, radians: straight on, a
    # quarter, half and whole circle.
    for yaw, pitch, roll in product(from_degrees(np.array([0.0, 90.0, 180.0, 360.0])).tolist(), *swings):
        if not (yaw or pitch or roll):
            continue
        angles = _angles(yaw, pitch, roll, vehicle)
        time_s = np.arange(len(angles)) / vehicle.sample_rate_hz
        duration_s = len(angles) / vehicle.sample_rate_hz
        readings_T = prior.errors.distort(calibration.intensity_T * field_directions(angles, inclination))
        scalar_T = np.full(len(angles), calibration.intensity_T) if calibration.array.scalar_noise_T else None
        rates = None if gyroscope is None else _rates(angles, 1 / vehicle.sample_rate_hz)
        recording = Recording(time_s, readings_T, scalar_T, angular_velocity_rad_s=rates)
        excess = excess_of(prior, expected_covariance(recording, calibration.array, Known(prior), gyroscope))
        # Seconds in a minute.
        turns.append(Turn(yaw, pitch, roll, duration_s, excess, (before - excess) * 60.0 / duration_s))
    return sorted(turns, key=lambda turn: -turn.gain_per_minute)


def _angles(yaw: float, pitch: float, roll: float, vehicle: Vehicle) -> FloatArray:
    """Return yaw, pitch and roll (N, 3) at the samples of a turn, none faster than the vehicle."""
    from scipy.constants import golden

    # The roll swings more slowly than the pitch, so that the two never repeat together.
    periods_s = 2 * np.pi * np.array([pitch, roll * golden]) / vehicle.turn_rate
    # Of pitch and roll at least, in a turn that has them.
    duration_s = max(yaw / vehicle.turn_rate, 2 * float(periods_s.max()))
    time_s = np.arange(max(2, round(duration_s * vehicle.sample_rate_hz))) / vehicle.sample_rate_hz
    swings = [
        limit * np.sin(2 * np.pi * time_s / period) if period else np.zeros_like(time_s)
        for limit, period in zip((pitch, roll), periods_s.tolist(), strict=True)
    ]
    return np.stack([yaw * time_s / time_s[-1], *swings], axis=1)


def _rates(angles: FloatArray, interval_s: float) -> FloatArray:
    """Return the angular velocities (N, 3) in the array frame of yaw, pitch and roll (N, 3), rad/s."""
    from scipy.spatial.transform import Rotation

    attitude = Rotation.from_euler("ZYX", angles)
    return at_samples((attitude[:-1].inv() * attitude[1:]).as_rotvec() / interval_s)


def at_samples(rates: FloatArray) -> FloatArray:
    """Return what rates (N - 1, 3) between samples are at the samples (N, 3)."""
    return np.vstack([rates[:1], (rates[:-1] + rates[1:]) / 2, rates[-1:]])


def expected_covariance(
    recording: Recording, array: KnownNoiseArray, known: Known, gyroscope: Gyroscope | None
) -> FloatArray:
    """Return the covariance (12 K, 12 K) of the errors that a fit of samples without noise would have.

    Parameters
    ----------
    recording : Recording
        Of K sensors, as they read at the start of what is known.
    array : KnownNoiseArray
        With every noise.
    known : Known
        Everything else that is known.
    gyroscope : Gyroscope, optional
        What measured the angular velocity; it counts where its noise is stated.
    """
    if gyroscope is not None and gyroscope.noise_density is not None and recording.angular_velocity_rad_s is not None:
        interval_s, start = float(np.median(np.diff(recording.time_s))), GyroscopeState.at_rest(np.eye(3), 0.0)
        use = GyroscopeUse(gyroscope.noise_density, gyroscope.bias, interval_s, start, gyroscope.scale_error)
        known = replace(known, gyroscope=use)
    problem = Problem.of(recording, array, known)
    size, found = 12 * array.sensor_count, problem.normal_at(problem.start)
    return inverted(found.information, problem.basis_at(problem.start))[:size, :size]


class LiveCoverage:
    """Coverage while samples arrive, from the raw readings of sensor 1 about the centre of their sphere.

    Parameters
    ----------
    capacity : int
        Samples kept; when they are full every second one is given up and only every second new one is taken.
    """

    def __init__(self, capacity: int = 4096) -> None:
        self._capacity = capacity
        self.reset()

    def reset(self) -> None:
        """Forget all samples."""
        self._kept: list[tuple[float, ...]] = []
        self._stride, self._seen, self._turned = 1, 0, 0

    def add(self, reading_T: Sequence[float], time_s: float = np.nan, has_rates: bool = False) -> None:
        """Add the raw reading (3,) of sensor 1, its stamp, and whether its angular velocity is known."""
        self._turned += has_rates
        if self._seen % self._stride == 0:
            self._kept.append((*reading_T, time_s))
            if len(self._kept) == self._capacity:
                self._kept, self._stride = self._kept[::2], 2 * self._stride
        self._seen += 1

    def summary(self) -> Coverage:
        """Return the coverage so far."""
        if len(self._kept) < 4:
            return judge_coverage(np.zeros(CELLS, dtype=int), np.zeros((CELLS, 3)))
        points = np.array(self._kept)[:, :3]
        return measure_coverage(points - sphere_center(points))

    def bought(self, array: Array) -> tuple[float, float | None]:
        """Return the largest standard error of a bias of sensor 1 so far, tesla, without and with the gyroscope.

        Infinite before the readings tell it; the second is None where no gyroscope is stated or most samples have none.
        """
        # 512 and 20: samples from which the standard error is computed, at most and at least: more change it by a
        # hundredth.
        sparse = -(-len(self._kept) // 512)
        kept = np.array(self._kept[:: max(sparse, 1)])
        is_used = array.gyroscope is not None and 2 * self._turned > self._seen
        if not is_used or len(kept) < 20 or array.vector_noise_T is None or array.scalar_noise_T is None:
            return np.inf, None
        if (np.diff(kept[:, 3]) <= 0).any():  # the clock was set
            return np.inf, None
        without, with_gyroscope = (
            float(_bias_errors(kept[:, :3], kept[:, 3], array, self._stride * sparse, has_rates).max())
            for has_rates in (False, True)
        )
        return without, with_gyroscope


def _bias_errors(points_T: FloatArray, time_s: FloatArray, array: Array, count: float, has_rates: bool) -> FloatArray:
    """Return the standard errors (3,) of the bias of sensor 1 by its readings so far, tesla; infinite where it is open.

    The scale is not known before. What the gyroscope reads about the field tells nothing, and the rest of its turn is
    that of the readings.

    Parameters
    ----------
    points_T : (N, 3) array
        Raw readings of sensor 1.
    time_s : (N,) array
        Their stamps, seconds.
    array : Array
        Whose noise is stated, and of whose gyroscope.
    count : float
        Number of samples that each represents.
    has_rates : bool
        Whether the angular velocity counts.
    """
    assert array.vector_noise_T is not None and array.scalar_noise_T is not None
    centred = points_T - sphere_center(points_T)
    lengths = np.linalg.norm(centred, axis=1, keepdims=True)
    radius_T = float(lengths.mean())
    if not (lengths > 0).all():  # sensors that are stuck
        return np.full(3, np.inf)
    along = centred / lengths
    rates = at_samples(np.cross(along[1:], along[:-1]) / np.diff(time_s)[:, None])
    scalar_T = np.full(len(along), radius_T)
    recording = Recording(time_s, radius_T * along[:, None], scalar_T, angular_velocity_rad_s=rates)
    noises_T = (each / np.sqrt(count) for each in (array.vector_noise_T[:1], array.scalar_noise_T))
    single = Array(np.zeros((1, 3)), *noises_T).with_stated_noise()
    known = Known(start=Place(SensorErrors.none(1), radius_T))
    covariance = expected_covariance(recording, single, known, array.gyroscope if has_rates else None)
    return np.sqrt(np.diag(covariance)[6:9])
