"""The answer to a pair beside its key."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from tam_calibration.comparison.result import UNKNOWN
from tam_validation.blind.outcome import Outcome

SIDES = {"missing": "missing_in_simulation", "surplus": "surplus_in_simulation"}
"""Keys of the answer by those of the key."""

SAME_MISTAKE = {"variance_for_deviation": {"no_noise"}}
"""Answers that are as right: the square of a nanotesla, in tesla, is none."""


@dataclass(frozen=True, eq=False)
class PairOutcome:
    """A pair's key and the answer to it.

    Parameters
    ----------
    name : str
    key, answer : dict
    left : dict, optional
        The comparison of the simulation that its maker mended.
    """

    name: str
    key: dict[str, Any]
    answer: dict[str, Any]
    left: dict[str, Any] | None = None

    @property
    def kind(self) -> str:
        """Kind of pair."""
        return str(self.key["kind"])

    @property
    def verdict(self) -> str:
        """Verdict of the answer."""
        return str(self.answer["verdict"])

    def told(self, side: str) -> list[dict[str, Any]]:
        """Return what the answer says of a side, missing or surplus, the first one first."""
        return list(self.answer.get(SIDES[side]) or [])

    def outcome(self, side: str, truth: dict[str, Any], told: dict[str, Any] | None) -> Outcome:
        """Return a cause beside one that is told, as a diagnosis' answer to a case with that cause alone."""
        named = told is not None and told["effect"] != UNKNOWN
        where = {} if told is None else {"sensors": told["sensors"], "axes": told["axes"]}
        answer = {"verdict": "explained" if named else "unexplained", "causes": [told] if named else [], "where": where}
        key = {"kind": "single", "effects": [truth], "sensors": 4, "with_scalar": True, "withheld_channel": ""}
        return Outcome(f"{self.name} {side}", key, answer)

    def finds(self, side: str, truth: dict[str, Any], count: int = 1) -> bool:
        """Say whether a cause is among the first of its side, with its place and its axis."""
        return any(_is_right(self.outcome(side, truth, told)) for told in self.told(side)[:count])

    @property
    def finds_all(self) -> bool:
        """Whether the first of each side are the true causes, in any order."""
        return all(self.finds(side, truth, len(self.key[side])) for side in SIDES for truth in self.key[side])

    @property
    def first_named(self) -> tuple[str, dict[str, Any]] | None:
        """The largest effect that is told by its name, and its side."""
        named = [(side, told) for side in SIDES for told in self.told(side) if told["effect"] != UNKNOWN]
        return max(named, key=lambda one: one[1]["size"] or 0.0, default=None)

    @property
    def first_name_is_wrong(self) -> bool:
        """Whether that is no cause of its side, by any of its names; louder or other noise is an excess of noise."""
        assert self.first_named is not None
        side, told = self.first_named
        if self.kind in ("level", "colour") and side == "missing":
            return bool(told["effect"] != "noise_excess")
        causes = [*self.key["missing"], *self.key["surplus"]] if self.kind == "other" else self.key[side]
        return not any(self.outcome(side, truth, told).first_is_tolerable for truth in causes)

    @property
    def other_side_is_empty(self) -> bool:
        """Whether nothing is told of a side that has no cause."""
        return not any(self.told(side) for side in SIDES if not self.key[side])

    @property
    def is_none_of_library(self) -> bool:
        """Whether a cause outside the library is told to be unknown, or by the name that is as right."""
        truth = self.key["missing"][0]
        told = next(iter(self.told("missing")), None)
        if told is None:
            return False
        return bool(told["effect"] in (UNKNOWN, truth["named"] or UNKNOWN))

    @property
    def has_other_parameters(self) -> bool:
        """Whether the effect of both is told to have other parameters."""
        truth = self.key["missing"][0]
        return any(
            self.outcome("missing", truth, told["recording"]).first_is_tolerable
            for told in self.answer.get("other_parameters") or []
        )

    @property
    def mistake_is_named(self) -> bool:
        """Whether the first mistake that is told is the true one."""
        kinds = [mistake["kind"] for mistake in self.answer.get("mistakes") or []]
        detail = self.key["detail"]
        return bool(kinds) and kinds[0] in {detail, *SAME_MISTAKE.get(detail, set())}

    @cached_property
    def level_errors(self) -> list[float]:
        """Relative errors of the levels of both sides' noise, of each axis and the scalar."""
        rows = self.answer.get("noise") or []
        return [
            row[f"{side}_nT"] / truth[_row(row)] - 1 for side, truth in self.key["noise_nT"].items() for row in rows
        ]

    @property
    def colours_right(self) -> list[bool]:
        """Whether the colour of the recording's noise is right, of each axis."""
        true = self.key["detail"] if self.kind == "colour" else "white"
        return [row["colour"] == true for row in self.answer.get("noise") or [] if row["axis"]]

    @property
    def noise_differences_right(self) -> list[bool]:
        """Whether the axes are told to differ whose noise does."""
        one, other = (np.array(self.key["noise_nT"][side]) for side in ("simulation", "recording"))
        true = np.abs(np.log(other / one)) > np.log(1.15)
        return [row["differs"] == true[_row(row)] for row in self.answer.get("noise") or []]

    @property
    def closed(self) -> tuple[float, float] | None:
        """The part of the gap that the answer's mend closes by the answer, and that which its maker's mend closes."""
        gap, left = self.answer.get("gap"), (self.left or {}).get("gap")
        if not gap or not left or not gap["before"]:
            return None
        return float(gap["closed"]), 1 - (left["before"] / gap["before"]) ** 2

    @property
    def line(self) -> str:
        """Key against answer in one line."""
        truth = [f"{side} {_words(one)} g={one['visible_gap']:.2g}" for side in SIDES for one in self.key[side]]
        conditions = f"N={self.key['samples']}, {self.key['rate_hz']:g} Hz, {self.key['motion']}"
        told = [f"{side} {_words(one)}" for side in SIDES for one in self.told(side)]
        told += [f"mistake {one['kind']}@{one['where']}" for one in self.answer.get("mistakes") or []]
        told += [f"other {_words(one['recording'])}" for one in self.answer.get("other_parameters") or []]
        noisy = [f"{row['sensor']}{row['axis'] or ''}" for row in self.answer.get("noise") or [] if row["differs"]]
        told += [f"noise of {' '.join(noisy)}"] * bool(noisy)
        why = self.answer.get("why") or (self.answer["statement"] if self.verdict == "not_identifiable" else "")
        why = f" ({why.strip().splitlines()[-1]})" if why else ""
        first = f"{self.name} {self.kind} {self.key['detail']} [{conditions}]"
        return f"{first}: {' + '.join(truth) or 'nothing'} → {self.verdict}{why}: {' + '.join(told) or 'nothing'}"


def _is_right(outcome: Outcome) -> bool:
    return (
        outcome.first_is_tolerable
        and outcome.place_of_cause_is_right
        and (not outcome.true_axis or outcome.axis_is_right)
    )


def _row(row: dict[str, Any]) -> int:
    """Return which of the key's levels a row of the answer is of."""
    return -1 if row["sensor"] == "scalar" else 3 * (int(row["sensor"]) - 1) + "xyz".index(row["axis"])


def _words(cause: dict[str, Any]) -> str:
    size = f" size {cause['size']:.2g}" if cause.get("size") is not None else ""
    probability = f" p={cause['probability']:.2f}" if cause.get("probability") is not None else ""
    return f"{cause['effect']}@{'/'.join(map(str, cause['sensors']))}{''.join(cause['axes'])}{size}{probability}"
