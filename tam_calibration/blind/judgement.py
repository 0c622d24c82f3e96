"""What makes an answer right."""

from tam_calibration.blind.outcome import EXPLAINED, NO_GAP, PARTLY_EXPLAINED, UNEXPLAINED, Outcome


def is_solved(one: Outcome) -> bool:
    """Say whether the first cause is the true one, and the verdict that it explains the gap."""
    return one.first_is_right and one.verdict == EXPLAINED


def is_nearly_solved(one: Outcome) -> bool:
    """Say the same with partners forgiven."""
    return one.first_is_tolerable and one.verdict == EXPLAINED


def is_admitted(one: Outcome) -> bool:
    """Say whether a cause outside the library is left unexplained, or called by a name that it has since, in place."""
    by_name = one.verdict == EXPLAINED and bool(one.causes) and set(one.named) <= one.other_names
    return (one.verdict == UNEXPLAINED or by_name) and one.place_is_right


def is_known_named(one: Outcome) -> bool:
    """Say whether the known cause beside an unknown one is named."""
    return one.truth[0] in one.named


def is_nothing_else_named(one: Outcome) -> bool:
    """Say whether nothing is named but the known cause, and the unknown one where it has a name since."""
    return set(one.named) <= {one.truth[0]} | one.other_names


def is_mixture_told(one: Outcome) -> bool:
    """Say whether the known cause is named, nothing else, and the verdict that it explains a part.

    Where the unknown cause has a name since, both names and the verdict that they explain all is as right.
    """
    both = one.verdict == EXPLAINED and set(one.named) == {one.truth[0]} | one.other_names and len(one.named) == 2
    return both or (one.verdict == PARTLY_EXPLAINED and set(one.named) == {one.truth[0]})


def is_spurious(one: Outcome) -> bool:
    """Say whether a cause is named that is not there."""
    return any(not one.tolerates(cause) for cause in one.causes)


def is_pair_solved(one: Outcome) -> bool:
    """Say whether both causes are named and no other."""
    return set(one.truth) == set(one.named)


def is_right_though_short(one: Outcome) -> bool:
    """Say whether a short recording's cause comes first, or no gap where there is none."""
    return one.first_is_right if one.truth else one.verdict == NO_GAP


def names_wrongly(one: Outcome) -> bool:
    """Say whether a wrong cause comes first."""
    return bool(one.causes) and not one.first_is_right


def names_strangely(one: Outcome) -> bool:
    """Say the same with partners forgiven."""
    return bool(one.causes) and not one.first_is_tolerable
