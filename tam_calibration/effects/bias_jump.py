"""A bias that jumps, once or on and off."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tam_calibration.effects.effect import Coefficient, LinearEffect, Misfit, Shape, Situation, SurrogateKind, Term
from tam_calibration.effects.moved_sphere import moved_sphere
from tam_calibration.effects.saturation import inside_range
from tam_calibration.effects.spikes import LONGEST_BURST
from tam_calibration.units import FloatArray

_LEAST_SAMPLES = 24
_SHORTEST = LONGEST_BURST + 1
"""Samples on either side of a jump; fewer are outliers."""

_ROUNDS = 3
_MOST_OF_ROWS = 3
_PRECISE = 1e-6

_GROSS = 0.01
"""Of the field: misfits above are no small disturbances, which the sums here take them for."""


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
    is_free_in_time: ClassVar[bool] = True
    has_exact_shapes: ClassVar[bool] = True
    surrogates: ClassVar[SurrogateKind] = "searched"
    shape_units: ClassVar[dict[str, str]] = {"time_s": "s", "end_s": "s"}

    def obstacle(self, situation: Situation) -> str | None:
        """Return that the recording is too short, where it is."""
        if situation.sample_count < _LEAST_SAMPLES:
            return f"{situation.sample_count} samples are too few to tell a jump"
        return None

    def shapes(self, situation: Situation, misfit: Misfit) -> Iterable[Shape]:
        """Return the times, and pairs of times, at which jumps of one row or of all explain most, of all samples.

        What an axis reads at the end of its range is no jump.
        """
        if situation.sample_count < _LEAST_SAMPLES:
            return []
        intensity = float(np.median(situation.intensity_T))
        shapes = self.sought(situation, inside_range(misfit))
        gross = None if np.sqrt(np.mean(misfit.row_shift_T**2)) < _GROSS * intensity else moved_sphere(misfit.recording)
        return shapes if gross is None else [gross.shape, *shapes]

    def sought(self, situation: Situation, misfit: Misfit) -> list[Shape]:
        """Return the times, and pairs of times, at which jumps of one row or of all explain most."""
        middle = (situation.time_s[1:] + situation.time_s[:-1]) / 2
        whole, *rows = (_best(path) for path in _paths(misfit))
        ranked = [sorted((row[kind] for row in rows), key=lambda jump: -jump.gain)[:_MOST_OF_ROWS] for kind in range(2)]
        cuts = dict.fromkeys(jump.cuts for jump in (*whole, *ranked[0], *ranked[1]) if jump.gain > 0)
        return [dict(zip(self.shape_units, (float(middle[cut]) for cut in found), strict=False)) for found in cuts]

    def terms(self, situation: Situation, shape: Shape) -> list[Term]:
        """Return an offset of each row from the one time on, until the other where there is one."""
        is_off = (situation.time_s < shape["time_s"]) | (situation.time_s >= shape.get("end_s", np.inf))
        step = np.where(is_off, 0.0, 1.0)[:, None]
        parts = [Coefficient("offset", "T")]
        return [Term.of_row(situation, row, "offset", parts, step) for row in range(situation.scalar_row + 1)]


@dataclass(frozen=True)
class _Jump:
    gain: float
    cuts: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class _Path:
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


def _best(path: _Path) -> tuple[_Jump, _Jump]:
    """Return the best single jump and the best pair of jumps on and off."""
    gain = path.gain()
    single = _Jump(float(gain.max()), (int(gain.argmax()),))
    largest = np.argmax(np.sum((path.score - path.score.mean(axis=0)) ** 2, axis=1))
    pair = max((_pair(path, start) for start in {single.cuts[0], int(largest)}), key=lambda jump: jump.gain)
    return single, pair


def _pair(path: _Path, start: int) -> _Jump:
    """Return a pair of jumps of which neither can be moved alone to gain more."""
    first, best = start, _Jump(0.0, (start,))
    for _ in range(_ROUNDS):
        gain = path.gain(first)
        second = int(gain.argmax())
        if gain[second] <= best.gain:
            break
        best = _Jump(float(gain[second]), (min(first, second), max(first, second)))
        first = second
    return best


def _paths(misfit: Misfit) -> Iterator[_Path]:
    """Yield the path of jumps anywhere in the differential channels, then that of each row alone."""
    counted = misfit.is_counted
    direction = misfit.situation.field_T / misfit.situation.intensity_T[:, None]
    constant = np.column_stack([counted, counted[:, None] * direction])
    own = np.where(counted[:, None], misfit.differential, 0)
    between = _path(own, constant, np.ones(len(own)) * counted)
    has_reference = counted & np.isfinite(misfit.common_mode)
    common = np.where(has_reference, misfit.common_mode, 0)
    slope = np.where(has_reference[:, None], misfit.row_slope, 0)
    first, second = np.triu_indices(3)
    functions = np.column_stack([direction, direction[:, first] * direction[:, second]]) * slope[:, -1:]
    norms = np.append(np.sum(misfit.directions**2, axis=1), 0)
    if between.score.shape[1]:
        yield between
    for row, norm in enumerate(norms):
        path = _path(common[:, None], functions, slope[:, row])
        score = path.score
        if row < len(misfit.directions):
            score = score + between.score @ misfit.directions[row][:, None]
        nuisance = np.concatenate([np.sqrt(norm) * between.nuisance, path.nuisance], axis=1)
        yield _Path(score, norm * between.information + path.information, nuisance)


def _path(residual: FloatArray, functions: FloatArray, slope: FloatArray) -> _Path:
    """Return the path of jumps of a size slope (N,) in residuals (N, C) of which functions (N, P) are nuisance."""
    value, vector = np.linalg.eigh(functions.T @ functions)
    kept = value > _PRECISE**2 * value[-1]
    orthonormal = functions @ (vector[:, kept] / np.sqrt(value[kept]))
    residual = residual - orthonormal @ (orthonormal.T @ residual)
    score = np.cumsum(slope[:, None] * residual, axis=0)
    nuisance = np.cumsum(slope[:, None] * orthonormal, axis=0)
    return _Path(score[:-1], np.cumsum(slope**2)[:-1], nuisance[:-1])
