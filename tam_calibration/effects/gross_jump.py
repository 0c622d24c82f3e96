"""A jump of the bias so large that no calibration fits without it, once or on and off.

It is searched before any calibration: two fits, one to the samples between two cuts and one to the others, or one fit
with an offset between them, leave a quarter of the residual of one fit to all.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm
from numpy.typing import NDArray

from tam_calibration.effects.grades import LEAST_SAMPLES, MINOR
from tam_calibration.effects.states import BiasJump
from tam_calibration.model.fitted_effect import Contribution, FittedEffect, Shape
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray

_BLOCKS = 300
"""Blocks of time between which a jump is searched first: 45 000 pairs."""

LEAST_FALL = 4.0
"""Ratio of the residual energies without and with a gross jump that it must reach: far above that of noise."""

Cuts = NDArray[np.intp]
"""Pairs of cuts (C, 2): the samples from the first on and before the second are those with the jump."""


def best_cuts(energy: Callable[[Cuts], FloatArray], count: int) -> Cuts | None:
    """Return the two cuts of least residual energy, the second at the end for a jump that lasts; None of few samples.

    Parameters
    ----------
    energy : callable
        Residual energies (C,) of pairs of cuts (C, 2).
    count : int
        Number of samples.
    """
    # In the shortest recordings as well a sphere lies through several blocks.
    bounds = np.linspace(0, count, min(_BLOCKS, count // LEAST_SAMPLES) + 1).astype(int)
    if len(bounds) < 4:
        return None
    first, last = (index.ravel() for index in np.meshgrid(bounds[1:-1], bounds[1:], indexing="ij"))
    pairs = np.column_stack([first, last])[first < last]
    best: Cuts = pairs[np.argmin(energy(pairs))]
    reach = int(bounds[1])
    for _ in range(2):
        for end in (0, 1):
            if best[end] == count:
                continue
            moved = best[end] + np.arange(-reach, reach + 1)
            tried = np.where(np.arange(2) == end, moved[:, None], best)
            inside = (tried[:, 0] > 0) & (tried[:, 0] < tried[:, 1]) & (tried[:, 1] <= count)
            best = tried[inside][np.argmin(energy(tried[inside]))]
    return best


def shape_of(time_s: FloatArray, cuts: Cuts) -> Shape:
    """Return the times of a jump at two cuts (2,) of samples at some times (N,)."""
    inner = cuts[cuts < len(time_s)]
    return dict(zip(BiasJump.shape_units, ((time_s[inner] + time_s[inner - 1]) / 2).tolist(), strict=False))


def gross_bias_jump(recording: Recording) -> FittedEffect | None:
    """Return the bias jump, once or on and off, that explains most of a gross residual; None where none does.

    Parameters
    ----------
    recording : Recording
        In a field of constant intensity, turned about several axes before and after the jump.
    """
    # Sums of 200 bytes are kept of each reading: a longer recording is thinned.
    thinning = recording.sample_count * recording.sensor_count // 500_000 + 1
    recording = recording.take(slice(None, None, thinning))
    sums = _Sums.of(recording)
    best = best_cuts(sums.residual_energy, recording.sample_count)
    if best is None:
        return None
    one, two = sums.residual_energy(np.array([[0, recording.sample_count], best]))
    jump = sums.jump(best)
    if one < LEAST_FALL * two or norm(jump, axis=1).max() < MINOR:
        return None
    contributions = tuple(
        Contribution(sensor, axis, "offset", {"offset": float(jump[sensor, axis] * sums.unit_T[sensor])})
        for sensor in range(recording.sensor_count)
        for axis in range(3)
    )
    return FittedEffect(BiasJump.name, shape_of(recording.time_s, best), contributions)


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
        # The fourth powers of readings a thousand times the field would swamp the sums.
        reading = np.clip(recording.readings_T / unit[:, None], -1e3, 1e3)
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
        ridge = 1e-12 * (1 + np.trace(self.total[-1, ..., :4, :4], axis1=-2, axis2=-1))
        information = sums[..., :4, :4] + ridge[:, None, None] * np.eye(4)
        score = sums[..., :4, 4]
        step = np.linalg.solve(information, score[..., None])[..., 0]
        return step, sums[..., 4, 4] - np.sum(score * step, axis=-1)
