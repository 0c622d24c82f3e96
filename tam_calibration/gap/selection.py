"""Which of the terms of an effect the data ask for: forward selection and backward elimination by BIC."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tam_calibration.effects.effect import Term
from tam_calibration.gap.regression import Projected


@dataclass(frozen=True, eq=False)
class Selection:
    """What was selected.

    Parameters
    ----------
    terms : tuple of int
        Indices of the selected terms, in the order of their listing.
    gain : float
        Energy that they explain.
    rank : int
        Directions that they spend.
    delta_bic : float
        n ln(S / (S - gain)) less what the choice costs; positive is for them.
    """

    terms: tuple[int, ...]
    gain: float
    rank: int
    delta_bic: float


def columns_of(terms: Sequence[Term]) -> list[np.ndarray]:
    """Return the columns of each term where they stand side by side."""
    ends = np.cumsum([len(term.coefficients) for term in terms])
    return [np.arange(end - len(term.coefficients), end) for end, term in zip(ends, terms, strict=True)]


def bundles_of(terms: Sequence[Term]) -> list[tuple[int, ...]]:
    """Return what may be added in one step: each term, those of a name in a sensor, those of a name in all sensors."""
    groups: dict[tuple[object, ...], list[int]] = {}
    for index, term in enumerate(terms):
        groups.setdefault((term.sensor, term.axis, term.name), []).append(index)
        if term.sensor >= 0:
            groups.setdefault((term.sensor, term.name), []).append(index)
            groups.setdefault((term.name,), []).append(index)
    return list(dict.fromkeys(tuple(group) for group in groups.values()))


def select(projected: Projected, terms: Sequence[Term], energy: float, count: float) -> Selection:
    """Return the terms that lower the free-scale BIC most, by steps.

    Parameters
    ----------
    projected : Projected
        Normal equations of all terms, the base eliminated.
    terms : sequence of Term
        In the order of the columns.
    energy, count : float
        Residual energy in front of the selection, and the number of channels.
    """
    columns, bundles = columns_of(terms), bundles_of(terms)
    choice = 2 * np.log(len(bundles))
    chosen: list[int] = []
    best, left = 0.0, projected
    gained, spent, steps = 0.0, 0, 0
    while True:
        new_terms = list(dict.fromkeys(tuple(sorted(set(bundle) - set(chosen))) for bundle in bundles))
        offers = [offer for offer in new_terms if offer]
        if not offers:
            break
        gains, ranks = left.gains([_join(columns, offer) for offer in offers])
        values = np.array([evidence(energy, gained + gain, count, spent + rank) for gain, rank in zip(gains, ranks)])
        values[ranks == 0] = -np.inf
        first = int(np.argmax(values))
        value = float(values[first]) - (steps + 1) * choice
        if not np.isfinite(value) or (chosen and value <= best):
            break
        best = value
        chosen += offers[first]
        gained, spent, steps = gained + gains[first], spent + int(ranks[first]), steps + 1
        if best <= 0:
            break
        left = left.without(_join(columns, offers[first]))
    return _trimmed(projected, columns, sorted(chosen), energy, count, steps * choice)


def evidence(energy: float, gain: float, count: float, rank: int) -> float:
    """Return n ln(S / (S - gain)) - p ln n: the free-scale BIC without the terms less that with them."""
    left = max(energy - gain, np.finfo(float).tiny)
    return float(count * np.log(energy / left) - rank * np.log(count))


def _join(columns: list[np.ndarray], terms: Iterable[int]) -> np.ndarray:
    return np.concatenate([columns[index] for index in terms])


def _trimmed(
    projected: Projected, columns: list[np.ndarray], chosen: list[int], energy: float, count: float, choice: float
) -> Selection:
    """Drop terms as long as BIC rises without them."""
    while chosen:
        kept = projected.take(_join(columns, chosen))
        inverse, rank = kept.inverse()
        values = inverse @ kept.score
        gain = float(kept.score @ values)
        best = Selection(tuple(chosen), gain, rank, evidence(energy, gain, count, rank) - choice)
        ends = np.cumsum([len(columns[index]) for index in chosen])
        rivals = []
        for end, index in zip(ends, chosen, strict=True):
            own = slice(end - len(columns[index]), end)
            # What is lost without a term follows from its values and their covariance.
            lost = float(values[own] @ np.linalg.pinv(inverse[own, own], hermitian=True) @ values[own])
            freed = min(rank, len(columns[index]))
            rivals.append(evidence(energy, gain - lost, count, rank - freed) - choice)
        if len(chosen) == 1 or max(rivals) <= best.delta_bic:
            return best
        del chosen[int(np.argmax(rivals))]
    return Selection((), 0.0, 0, 0.0)
