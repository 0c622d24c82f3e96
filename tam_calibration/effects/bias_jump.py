"""A bias that jumps, once or on and off, also so far that the sphere of the readings visibly moves."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm
from numpy.typing import NDArray

from tam_calibration.effects.change_points import Path, StepEffect, is_on, shape_of, without
from tam_calibration.effects.effect import Covariates
from tam_calibration.effects.grades import LEAST_SAMPLES, MINOR, NEGLIGIBLE
from tam_calibration.effects.saturation import inside_range
from tam_calibration.effects.spikes import without_spikes
from tam_calibration.effects.term import Coefficient, Term, WhitenedResiduals
from tam_calibration.model.fitted_effect import Contribution, FittedEffect, Shape
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray

_MOST_READINGS = 500_000
"""Readings of which cumulative sums are kept, 200 bytes each; a longer recording is thinned."""

_BLOCKS = 300
"""Blocks of time between which a jump is searched first: 45 000 pairs."""

_ROUNDS = 2
"""Rounds of refining either end of a jump to the sample, the other end held."""

LEAST_FALL = 4.0
"""Ratio of the residual energies without and with a gross jump that it must reach: far above that of noise."""


def gross_bias_jump(recording: Recording) -> FittedEffect | None:
    """Return the bias jump, once or on and off, that explains most of a gross residual; None where none does.

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
    best = pairs[np.argmin(sums.residual_energy(pairs))]
    reach = int(bounds[1])
    for _ in range(_ROUNDS):
        for end in (0, 1):
            if best[end] == count:
                continue
            moved = best[end] + np.arange(-reach, reach + 1)
            tried = np.where(np.arange(2) == end, moved[:, None], best)
            inside = (tried[:, 0] > 0) & (tried[:, 0] < tried[:, 1]) & (tried[:, 1] <= count)
            best = tried[inside][np.argmin(sums.residual_energy(tried[inside]))]
    one, two = sums.residual_energy(np.array([[0, count], best]))
    jump = sums.jump(best)
    if one < LEAST_FALL * two or norm(jump, axis=1).max() < MINOR:
        return None
    shape = shape_of(recording.time_s, [cut - 1 for cut in best if cut < count])
    contributions = tuple(
        Contribution(sensor, axis, "offset", {"offset": float(jump[sensor, axis] * sums.unit_T[sensor])})
        for sensor in range(recording.sensor_count)
        for axis in range(3)
    )
    return FittedEffect("bias_jump", shape, contributions)


_ROUNDING = 1e-12
"""Rounding error of differences of the cumulative sums, as a part of the sums over all samples."""

_FARTHEST = 1e3
"""Limit of readings, in units of the field: the fourth powers of larger ones would swamp the sums."""


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

    def residual_energy(self, cuts: NDArray[np.intp]) -> FloatArray:
        """Return the residual energies (C,) of two spheres, one between each pair of cuts (C, 2), one outside."""
        inside = self.total[cuts[:, 1]] - self.total[cuts[:, 0]]
        return np.asarray(np.sum(self._fit(inside)[1] + self._fit(self.total[-1] - inside)[1], axis=1))

    def jump(self, cuts: NDArray[np.intp]) -> FloatArray:
        """Return the offset of the sphere between two cuts from the other, (K, 3), in units of the field."""
        inside = self.total[cuts[1]] - self.total[cuts[0]]
        return (self._fit(inside)[0] - self._fit(self.total[-1] - inside)[0])[:, :3] / 2

    def _fit(self, sums: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return coefficients (..., 4) and residual energy (...) of spheres fitted to samples with sums (..., 5, 5)."""
        # As large as the rounding of differences of all sums.
        ridge = _ROUNDING * (1 + np.trace(self.total[-1, ..., :4, :4], axis1=-2, axis2=-1))
        information = sums[..., :4, :4] + ridge[:, None, None] * np.eye(4)
        score = sums[..., :4, 4]
        step = np.linalg.solve(information, score[..., None])[..., 0]
        return step, sums[..., 4, 4] - np.sum(score * step, axis=-1)


_MOST_OF_ROWS = 3
"""Rows whose best times are tried for all rows: those in which a jump explains most."""


class BiasJump(StepEffect):
    """Offsets of axes change at one time, for good or until another time."""

    name = "bias_jump"

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return the times, and pairs of times, at which jumps of one row or of all explain most, of all samples.

        Samples at the end of an axis' range, and spikes that occur with the motion, do not count.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        residuals : WhitenedResiduals
            Of the same N samples.
        """
        intensity = float(np.median(covariates.intensity_T))
        whole, *rows = (path.best() for path in _paths(without_spikes(inside_range(residuals), of_motion=True)))
        ranked = [sorted((row[kind] for row in rows), key=lambda jump: -jump.gain)[:_MOST_OF_ROWS] for kind in range(2)]
        cuts = dict.fromkeys(jump.cuts for jump in (*whole, *ranked[0], *ranked[1]) if jump.gain > 0)
        shapes: list[Shape] = [shape_of(covariates.time_s, found) for found in cuts]
        is_small = covariates.follows_attitude or np.sqrt(np.mean(residuals.row_shift_T**2)) < NEGLIGIBLE * intensity
        gross = None if is_small else gross_bias_jump(residuals.recording)
        return shapes if gross is None else [gross.shape, *shapes]

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return an offset of each row from the one time on, until the other where there is one.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        shape : Shape
            ``time_s`` of the jump and, where it ends, ``end_s``, seconds.
        """
        step = is_on(covariates.time_s, shape)[:, None].astype(float)
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
