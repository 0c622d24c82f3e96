"""Jumps of a bias that are no small disturbance: the sphere on which readings lie moves.

The readings y of a sensor in a field of intensity F have |y|² = 2 o·y + F² - |o|² but for errors of scale, which is
linear in the bias o and in the rest. Sums over the samples tell how well two such spheres fit, for any time or pair of
times at which the one takes the place of the other, whatever the size of the jump and without a calibration.
"""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm
from numpy.typing import NDArray

from tam_calibration.effects.fitted import Contribution, FittedEffect
from tam_calibration.effects.grades import LEAST_SAMPLES, MINOR
from tam_calibration.recording import Recording
from tam_calibration.units import FloatArray

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
