"""The search for the causes of a gap, from several starts."""

from collections.abc import Collection
from dataclasses import dataclass

from tam_calibration.array import Array
from tam_calibration.gap.hypotheses import Evidence, rivals
from tam_calibration.gap.looking import Looking, Outcome, Progress
from tam_calibration.gap.model import Model
from tam_calibration.gap.result import Considered
from tam_calibration.gap.support import Step
from tam_calibration.recording import Recording


@dataclass(frozen=True, eq=False)
class Search:
    """The whole search.

    Parameters
    ----------
    nominal, model : Model
        In front of the causes, and with them.
    steps : tuple of Step
        The causes, in the order in which they were accepted.
    weighed, rivals : tuple of Evidence
        What was weighed at the nominal model.
    remaining : tuple of Evidence
        What functions without physics still explain beside the causes.
    considered : tuple of Considered
        Hypotheses without evidence.
    """

    nominal: Model
    model: Model
    steps: tuple[Step, ...]
    weighed: tuple[Evidence, ...]
    rivals: tuple[Evidence, ...]
    remaining: tuple[Evidence, ...]
    considered: tuple[Considered, ...]


def search(
    recording: Recording, array: Array, without: Collection[str] = (), progress: Progress | None = None
) -> Search:
    """Look for causes, the strongest first, until nothing more speaks for one; then drop those that do not hold.

    The strongest at first need not be a cause: what acts on all sensors may be one thing at one of them and another at
    the scalar magnetometer. The search is made again from other starts where that may be, and the best is kept; also
    from the calibration of a steady part, where that of the whole leaves gross misfits that no cause explains.
    """
    tell = progress or (lambda what, part: None)
    tell("nominal calibration", 0.0)
    looking = Looking(Model.nominal(recording, array), frozenset(without), tell)
    best = _best(looking)
    if not best.is_clean and (steady := looking.nominal.steady()) is not None:
        again = Looking(steady, frozenset(without), tell)
        there = _best(again)
        if not (best.steps or there.steps) or _rank(there) > _rank(best):
            looking, best = again, there
    unknown = rivals(looking.first_base)
    return Search(looking.nominal, best.model, best.steps, looking.weighed, unknown, best.remaining, looking.considered)


def _best(looking: Looking) -> Outcome:
    """Return the best outcome of the starts at one nominal model."""
    best = looking.found(looking.gross)
    for start in looking.other_starts(best):
        if best.is_clean:
            break
        best = max(best, looking.found(start), key=_rank)
    return best


def _rank(outcome: Outcome) -> tuple[bool, float]:
    return outcome.is_clean, outcome.evidence
