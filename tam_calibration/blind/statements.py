"""What an answer says of its own certainty, held against what came true: probabilities, sets of causes, intervals."""

from collections import defaultdict
from collections.abc import Sequence
from statistics import median

from tam_calibration.blind.figures import Row, rate_row
from tam_calibration.blind.outcome import Outcome
from tam_calibration.blind.rates import constant_log_score, log_score, separation


def probability_rows(outcomes: Sequence[Outcome]) -> list[Row]:
    """Return how much the probabilities of the first answers tell that the verdict alone does not."""
    pairs = [(one.verdict, one.first_told) for one in outcomes]
    told = [pair for _, pair in pairs if pair is not None]
    groups = defaultdict(list)
    for verdict, pair in pairs:
        if pair is not None:
            groups[verdict].append(pair[1])
    own, constant = log_score(told), constant_log_score(groups.values())
    both = {came for _, came in told} == {True, False}
    return [
        Row(
            "log score over that of a constant per verdict",
            "",
            own / constant if told else float("nan"),
            None,
            0.5,
            len(told),
            remark=f"{own:.3f} and {constant:.3f}",
            is_share=False,
        ),
        Row("right and wrong told apart (AUROC)", "", separation(told), 0.9, None, len(told) if both else 0),
    ]


def set_rows(outcomes: Sequence[Outcome]) -> list[Row]:
    """Return how often the 95 % sets of causes hold the true one, and how large they are."""
    told = [one for one in outcomes if one.set_95 is not None]
    middle = median([len(one.set_95 or []) for one in told] or [float("nan")])
    return [
        rate_row("95 % sets hold the true cause", "", (one.set_holds for one in told), 0.93, 0.97),
        Row("95 % sets, median size", "", middle, None, 1.0, len(told), is_share=False),
    ]


def interval_rows(outcomes: Sequence[Outcome]) -> list[Row]:
    """Return how often the 95 % intervals of parameters hold the true values, alone and beside an unknown cause."""
    alone, beside = (
        [held for one in outcomes if (one.kind == "mixed") == mixed for held in one.coefficients_held()]
        for mixed in (False, True)
    )
    name = "95 % intervals of parameters hold the true values"
    return [rate_row(name, "", alone, 0.93, 0.97), rate_row(name, "beside an unknown", beside, 0.93, 0.97)]
