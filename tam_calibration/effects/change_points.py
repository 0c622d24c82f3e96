"""Change points: the times at which something begins, or begins and ends, by sums over the samples up to each.

Every place is tried at the cost of one: a change behind a sample explains what its score and information are from
there on (Page, Continuous inspection schemes, Biometrika 41, 1954, p. 100).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.effect import LinearEffect, Shape
from tam_calibration.effects.grades import LONGEST_BURST
from tam_calibration.model.units import FloatArray

_ROUNDS = 3
"""Rounds of searching the two times of a pair in turn, the other held."""

_PRECISE = 1e-6
"""Rounding error of an information, as a part of it."""


@dataclass(frozen=True)
class Change:
    """A change after one sample, or between two, and the energy that it explains."""

    gain: float
    cuts: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Path:
    """Cumulative sums over the samples, of which every change point is tried.

    Parameters
    ----------
    score : (N - 1, P, C) array
        Of P functions that change in C channels, the nuisance functions projected out.
    information : (N - 1, P, P) array
        Of the functions, the same in every channel.
    nuisance : (N - 1, Q, P) array
        Products of the functions with orthonormal nuisance functions.
    """

    score: FloatArray
    information: FloatArray
    nuisance: FloatArray

    @classmethod
    def of(cls, left: FloatArray, basis: FloatArray, functions: FloatArray) -> "Path":
        """Return the path of functions (N, P) that change in residuals (N, C), all zero in samples that do not count.

        The residuals and the orthonormal basis (N, Q) of the nuisance functions are those of ``without``.

        Parameters
        ----------
        left : (N, C) array
            Residuals, nuisance functions projected out.
        basis : (N, Q) array
            Orthonormal basis of the nuisance functions.
        functions : (N, P) array
            Functions whose coefficients change.
        """
        return cls(_summed(functions, left), _summed(functions, functions), _summed(basis, functions))

    @property
    def width(self) -> int:
        """Number of free numbers of a change."""
        return int(np.prod(self.score.shape[1:]))

    def beside(self, other: "Path") -> "Path":
        """Return the path of a change that is common to the channels of this path and another."""
        nuisance = np.concatenate([self.nuisance, other.nuisance], axis=1)
        return Path(self.score + other.score, self.information + other.information, nuisance)

    def best(self, stride: int = 1) -> tuple[Change, Change]:
        """Return the best single change and the best pair of changes on and off.

        They are searched at every stride-th sample first, then at all samples around the best.
        """
        coarse = np.arange(stride - 1, len(self.score), stride)
        single = self._moved(Change(0.0, (int(coarse[np.argmax(self._gain(coarse))]),)), stride)
        score = self.score[coarse]
        distance = score - score.mean(axis=0)
        largest = int(coarse[np.argmax(np.einsum("npc,npc->n", distance, distance))])
        pair = max((self._pair(start, coarse) for start in {single.cuts[0], largest}), key=lambda change: change.gain)
        return single, self._moved(pair, stride)

    def _gain(self, cuts: NDArray[np.intp], given: int | None = None) -> FloatArray:
        """Return the gain of a change after each of some samples, or between it and a given one."""
        score, information, nuisance = self.score[cuts], self.information[cuts], self.nuisance[cuts]
        enough = (cuts >= LONGEST_BURST) & (cuts < len(self.score) - LONGEST_BURST)
        if given is not None:
            score, nuisance = score - self.score[given], nuisance - self.nuisance[given]
            information = np.where(cuts < given, -1, 1)[:, None, None] * (information - self.information[given])
            enough &= np.abs(cuts - given) > LONGEST_BURST
        whole = np.diag(self.information[-1])
        left = information - nuisance.transpose(0, 2, 1) @ nuisance
        left += np.diag(np.maximum(_PRECISE * whole, np.finfo(float).tiny))
        values = score / left if left.shape[1] == 1 else np.linalg.solve(left, score)
        return np.asarray(np.sum(score * values, axis=(1, 2)) * enough)

    def _pair(self, start: int, cuts: NDArray[np.intp]) -> Change:
        """Return a pair of changes at some samples, a local optimum in each of the two times."""
        first, best = start, Change(0.0, (start, start))
        for _ in range(_ROUNDS):
            gain = self._gain(cuts, first)
            second = int(cuts[gain.argmax()])
            if gain.max() <= best.gain:
                break
            best = Change(float(gain.max()), (min(first, second), max(first, second)))
            first = second
        return best

    def _moved(self, change: Change, reach: int) -> Change:
        """Return a change with each of its times in turn moved to the best within less than reach samples."""
        cuts, most = list(change.cuts), 0.0
        for place, cut in enumerate(cuts):
            given = cuts[1 - place] if len(cuts) == 2 else None
            around = np.arange(max(cut - reach + 1, 0), min(cut + reach, len(self.score)))
            gain = self._gain(around, given)
            cuts[place], most = int(around[gain.argmax()]), float(gain.max())
        return Change(most, tuple(sorted(cuts)))


def without(residual: FloatArray, nuisance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return residuals (N, C) with functions (N, Q) projected out, and an orthonormal basis of these.

    Parameters
    ----------
    residual : (N, C) array
        Residuals of C channels.
    nuisance : (N, Q) array
        Nuisance functions, which may be linearly dependent.
    """
    value, vector = np.linalg.eigh(nuisance.T @ nuisance)
    kept = value > _PRECISE**2 * value[-1]
    basis = nuisance @ (vector[:, kept] / np.sqrt(value[kept]))
    return residual - basis @ (basis.T @ residual), basis


def _summed(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return the sums (N - 1, P, Q) of products of values (N, P) and (N, Q) up to each sample but the last."""
    return np.cumsum(left[:, :, None] * right[:, None, :], axis=0)[:-1]


class StepEffect(LinearEffect):
    """What begins at a time, and may end at another."""

    is_free_in_time: ClassVar[bool] = True
    is_step: ClassVar[bool] = True
    may_repeat: ClassVar[bool] = True
    has_exact_shapes: ClassVar[bool] = True
    shape_units: ClassVar[dict[str, str]] = {"time_s": "s", "end_s": "s"}


def shape_of(time_s: FloatArray, cuts: Sequence[int]) -> dict[str, float]:
    """Return the times of a step that begins, and may end, behind some samples (one or two of N)."""
    before = np.array(cuts)
    middle = (time_s[before + 1] + time_s[before]) / 2
    return dict(zip(StepEffect.shape_units, middle.tolist(), strict=False))


def is_on(time_s: FloatArray, shape: Shape) -> NDArray[np.bool_]:
    """Return at which of (N,) times a step has begun and not ended."""
    return np.asarray((time_s >= shape["time_s"]) & (time_s < shape.get("end_s", np.inf)))
