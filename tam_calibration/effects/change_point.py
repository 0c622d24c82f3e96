"""When offsets change: sums over the samples up to each tell what a jump at any time, or a pair of jumps, explains."""

from dataclasses import dataclass

import numpy as np

from tam_calibration.effects.spikes import LONGEST_BURST
from tam_calibration.units import FloatArray

_SHORTEST = LONGEST_BURST + 1
"""Samples on either side of a jump; fewer are outliers."""

_ROUNDS = 3
_PRECISE = 1e-6


@dataclass(frozen=True)
class Jump:
    """What a jump, or a pair, explains, and the samples behind which it happens."""

    gain: float
    cuts: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Path:
    """Sums over the samples up to each: of the score, its information, and its products with the nuisance.

    ``score`` (N - 1, C) has the part that the nuisance explains taken off; ``nuisance`` (N - 1, P) is orthonormal.
    """

    score: FloatArray
    information: FloatArray
    nuisance: FloatArray

    def gain(self, given: int | None = None) -> FloatArray:
        """Return the gain of a jump behind each sample, or of one between it and a given one."""
        if given is None:
            score, information, nuisance = self.score, self.information, self.nuisance
        else:
            score, nuisance = self.score - self.score[given], self.nuisance - self.nuisance[given]
            information = np.abs(self.information - self.information[given])
        left = information - np.einsum("nj,nj->n", nuisance, nuisance)
        enough = left > _PRECISE * self.information[-1]
        enough[: _SHORTEST - 1] = enough[len(left) - _SHORTEST + 1 :] = False
        if given is not None:
            enough[max(given - _SHORTEST + 1, 0) : given + _SHORTEST] = False
        gain: FloatArray = np.divide(np.sum(score**2, axis=1), left, out=np.zeros_like(left), where=enough)
        return gain


def best_jumps(path: Path) -> tuple[Jump, Jump]:
    """Return the best single jump and the best pair of jumps on and off."""
    gain = path.gain()
    single = Jump(float(gain.max()), (int(gain.argmax()),))
    largest = np.argmax(np.sum((path.score - path.score.mean(axis=0)) ** 2, axis=1))
    pair = max((_pair(path, start) for start in {single.cuts[0], int(largest)}), key=lambda jump: jump.gain)
    return single, pair


def _pair(path: Path, start: int) -> Jump:
    """Return a pair of jumps of which neither can be moved alone to gain more."""
    first, best = start, Jump(0.0, (start,))
    for _ in range(_ROUNDS):
        gain = path.gain(first)
        second = int(gain.argmax())
        if gain[second] <= best.gain:
            break
        best = Jump(float(gain[second]), (min(first, second), max(first, second)))
        first = second
    return best


def path_of(residual: FloatArray, functions: FloatArray, slope: FloatArray) -> Path:
    """Return the path of jumps of a size slope (N,) in residuals (N, C) of which functions (N, P) are nuisance."""
    value, vector = np.linalg.eigh(functions.T @ functions)
    kept = value > _PRECISE**2 * value[-1]
    orthonormal = functions @ (vector[:, kept] / np.sqrt(value[kept]))
    residual = residual - orthonormal @ (orthonormal.T @ residual)
    score = np.cumsum(slope[:, None] * residual, axis=0)
    nuisance = np.cumsum(slope[:, None] * orthonormal, axis=0)
    return Path(score[:-1], np.cumsum(slope**2)[:-1], nuisance[:-1])
