"""A bias that jumps, once or on and off, also so far that the sphere on which readings lie moves."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.linalg import norm
from numpy.typing import NDArray

from tam_calibration.effects.change_points import Path, without
from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.effect import Limit, LinearEffect, SurrogateKind
from tam_calibration.effects.grades import LEAST_SAMPLES, MINOR, NEGLIGIBLE
from tam_calibration.effects.saturation import inside_range
from tam_calibration.effects.spikes import without_spikes_of_motion
from tam_calibration.effects.term import Coefficient, Term, WhitenedResiduals
from tam_calibration.model.fitted_effect import Contribution, FittedEffect, Shape
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray

_MOST_READINGS = 500_000
"""Readings of which sums are kept, 200 bytes each; of a longer recording some samples serve."""

_BLOCKS = 300
"""Between which a jump is sought first: all pairs of them are 45 000."""

_ROUNDS = 2
"""Searches for either end of a jump, sample by sample, beside the other as it was found last."""

LEAST_FALL = 4.0
"""How many times smaller the squares must be with a gross jump than without; noise does not make twos of one."""


def moved_sphere(recording: Recording) -> FittedEffect | None:
    """Return the bias jump, once or on and off, that explains most of gross errors; None where there are none.

    Parameters
    ----------
    recording : Recording
        In a field of constant intensity, turned about several axes before and after the jump.
    """
    thinning = recording.sample_count * recording.sensor_count // _MOST_READINGS + 1
    recording = recording.take(slice(None, None, thinning))
    sums = _Sums.of(recording)
    count = recording.sample_count
    # In the shortest recordings as well a sphere lies through several blocks.
    bounds = np.linspace(0, count, min(_BLOCKS, count // LEAST_SAMPLES) + 1).astype(int)
    if len(bounds) < 4:
        return None
    first, last = (index.ravel() for index in np.meshgrid(bounds[1:-1], bounds[1:], indexing="ij"))
    pairs = np.column_stack([first, last])[first < last]
    best = pairs[np.argmin(sums.left(pairs))]
    reach = int(bounds[1])
    for _ in range(_ROUNDS):
        for end in (0, 1):
            if best[end] == count:
                continue
            moved = best[end] + np.arange(-reach, reach + 1)
            tried = np.where(np.arange(2) == end, moved[:, None], best)
            inside = (tried[:, 0] > 0) & (tried[:, 0] < tried[:, 1]) & (tried[:, 1] <= count)
            best = tried[inside][np.argmin(sums.left(tried[inside]))]
    one, two = sums.left(np.array([[0, count], best]))
    jump = sums.jump(best)
    if one < LEAST_FALL * two or norm(jump, axis=1).max() < MINOR:
        return None
    middle = (recording.time_s[1:] + recording.time_s[:-1]) / 2
    shape = {name: float(middle[cut - 1]) for name, cut in zip(("time_s", "end_s"), best, strict=True) if cut < count}
    contributions = tuple(
        Contribution(sensor, axis, "offset", {"offset": float(jump[sensor, axis] * sums.unit_T[sensor])})
        for sensor in range(recording.sensor_count)
        for axis in range(3)
    )
    return FittedEffect("bias_jump", shape, contributions)


_ROUNDING = 1e-12
"""Part of the sums over all samples that rounding leaves of the differences of two."""

_FARTHEST = 1e3
"""Readings of so many times the field are no sphere, and sums with their fourth powers hold nothing else."""


@dataclass(frozen=True, eq=False)
class _Sums:
    """Sums over the samples before each, for each sensor: of [y, 1, |y|²] times itself, readings in units of the field.

    ``total`` is (N + 1, K, 5, 5), ``unit_T`` (K,).
    """

    total: FloatArray
    unit_T: FloatArray

    @classmethod
    def of(cls, recording: Recording) -> "_Sums":
        unit = np.median(norm(recording.readings_T, axis=2), axis=0)
        reading = np.clip(recording.readings_T / unit[:, None], -_FARTHEST, _FARTHEST)
        size = np.sum(reading**2, axis=2, keepdims=True)
        own = np.concatenate([reading, np.ones_like(size), size], axis=2)
        total = np.zeros((recording.sample_count + 1, recording.sensor_count, 5, 5))
        np.cumsum(own[..., :, None] * own[..., None, :], axis=0, out=total[1:])
        return cls(total, unit)

    def left(self, cuts: NDArray[np.intp]) -> FloatArray:
        """Return the sums of squares (C,) left by two spheres, one between each pair of cuts (C, 2), one outside."""
        inside = self.total[cuts[:, 1]] - self.total[cuts[:, 0]]
        squares: FloatArray = np.sum(self._fit(inside)[1] + self._fit(self.total[-1] - inside)[1], axis=1)
        return squares

    def jump(self, cuts: NDArray[np.intp]) -> FloatArray:
        """Return how far the sphere between two cuts lies from the other, (K, 3)."""
        inside = self.total[cuts[1]] - self.total[cuts[0]]
        return (self._fit(inside)[0] - self._fit(self.total[-1] - inside)[0])[:, :3] / 2

    def _fit(self, sums: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return coefficients (..., 4) and sum of squares left (...) of spheres through samples of sums (..., 5, 5)."""
        # As large as the rounding of differences of all sums.
        ridge = _ROUNDING * (1 + np.trace(self.total[-1, ..., :4, :4], axis1=-2, axis2=-1))
        information = sums[..., :4, :4] + ridge[:, None, None] * np.eye(4)
        score = sums[..., :4, 4]
        step = np.linalg.solve(information, score[..., None])[..., 0]
        return step, sums[..., 4, 4] - np.sum(score * step, axis=-1)


_MOST_OF_ROWS = 3
"""Rows, those in which a jump explains most, whose times are tried for all."""


class BiasJump(LinearEffect):
    """Offsets of axes change at one time, for good or until another time."""

    name: ClassVar[str] = "bias_jump"
    title: ClassVar[str] = "bias that jumps"
    physics: ClassVar[str] = (
        "A magnet or tool that comes near, a shock to magnetised parts or an electronic reset changes the bias at once "
        "(Ripka, Magnetic Sensors and Magnetometers, Artech House, 2001: perming); its time is where the cumulative "
        "sum of the residuals turns (Page, Continuous inspection schemes, Biometrika 41, 1954, p. 100)."
    )
    excitation: ClassVar[str] = "turn through the same attitudes before and after the jump"
    may_be: ClassVar[tuple[str, ...]] = ("temperature_drift",)
    is_free_in_time: ClassVar[bool] = True
    is_step: ClassVar[bool] = True
    may_repeat: ClassVar[bool] = True
    has_exact_shapes: ClassVar[bool] = True
    surrogates: ClassVar[SurrogateKind] = "at_other_times"
    shape_units: ClassVar[dict[str, str]] = {"time_s": "s", "end_s": "s"}
    limits: ClassVar[Mapping[str, Limit]] = {
        "offset": Limit(
            1e-2,
            "a magnet of 1 cm of neodymium iron boron makes 8 mT at 3 cm; Furlani, Permanent Magnet and "
            "Electromechanical Devices, Academic Press, 2001, chapter 4",
            "T",
        )
    }

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that the recording is too short, where it is."""
        if covariates.sample_count < LEAST_SAMPLES:
            return f"{covariates.sample_count} samples are too few to tell a jump"
        return None

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return the times, and pairs of times, at which jumps of one row or of all explain most, of all samples.

        What an axis reads at the end of its range is no jump, nor are spikes that come with the motion.
        """
        if covariates.sample_count < LEAST_SAMPLES:
            return []
        intensity = float(np.median(covariates.intensity_T))
        middle = (covariates.time_s[1:] + covariates.time_s[:-1]) / 2
        whole, *rows = (path.best() for path in _paths(without_spikes_of_motion(inside_range(residuals))))
        ranked = [sorted((row[kind] for row in rows), key=lambda jump: -jump.gain)[:_MOST_OF_ROWS] for kind in range(2)]
        cuts = dict.fromkeys(jump.cuts for jump in (*whole, *ranked[0], *ranked[1]) if jump.gain > 0)
        shapes: list[Shape] = [
            dict(zip(self.shape_units, (float(middle[cut]) for cut in found), strict=False)) for found in cuts
        ]
        is_small = covariates.follows_attitude or np.sqrt(np.mean(residuals.row_shift_T**2)) < NEGLIGIBLE * intensity
        gross = None if is_small else moved_sphere(residuals.recording)
        return shapes if gross is None else [gross.shape, *shapes]

    def always(self, shape: Shape) -> Shape | None:
        """Return a jump that was there before the first sample."""
        return {"time_s": -np.inf}

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return an offset of each row from the one time on, until the other where there is one."""
        is_off = (covariates.time_s < shape["time_s"]) | (covariates.time_s >= shape.get("end_s", np.inf))
        step = np.where(is_off, 0.0, 1.0)[:, None]
        parts = [Coefficient("offset", "T")]
        return [Term.of_row(covariates, row, "offset", parts, step) for row in range(covariates.scalar_row + 1)]


def _paths(residuals: WhitenedResiduals) -> Iterator[Path]:
    """Yield the path of jumps anywhere in the differential channels, then that of each row alone."""
    counted = residuals.is_counted
    direction = residuals.covariates.field_T / residuals.covariates.intensity_T[:, None]
    constant = np.column_stack([counted, counted[:, None] * direction])
    own = np.where(counted[:, None], residuals.differential, 0)
    between = Path.of(*without(own, constant), counted[:, None].astype(float))
    has_reference = counted & np.isfinite(residuals.common_mode)
    common = np.where(has_reference, residuals.common_mode, 0)
    slope = np.where(has_reference[:, None], residuals.row_slope, 0)
    first, second = np.triu_indices(3)
    functions = np.column_stack([direction, direction[:, first] * direction[:, second]]) * slope[:, -1:]
    norms = np.append(np.sum(residuals.directions**2, axis=1), 0)
    common_left, basis = without(common[:, None], functions)
    if between.score.shape[2]:
        yield between
    for row, size in enumerate(norms):
        path = Path.of(common_left, basis, slope[:, row, None])
        score = path.score
        if row < len(residuals.directions):
            score = score + between.score @ residuals.directions[row][:, None]
        nuisance = np.concatenate([np.sqrt(size) * between.nuisance, path.nuisance], axis=1)
        yield Path(score, size * between.information + path.information, nuisance)
