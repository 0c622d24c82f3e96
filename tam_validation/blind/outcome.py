"""The answer of a diagnosis to a case, compared with its key."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from tam_validation.blind.rates import WITHIN_95

NO_GAP = "no_gap"
EXPLAINED = "explained"
PARTLY_EXPLAINED = "partly_explained"
UNEXPLAINED = "unexplained"
_NONE = "none"
"""The hypothesis that the cause is none of the library's effects."""

_PARTNERS = (
    frozenset({"time_skew", "eddy_current"}),
    frozenset({"nonlinearity", "hysteresis"}),
    frozenset({"crosstalk", "eddy_current"}),
)
"""Effects of which one holds the other within it, on any data: what leaks late is, in the first order, what leaks in
time, a misalignment, and a multiple of the field's change.

Stated here and not read from the effects' classes: a judge who asks the judged what is alike would pass its mistakes.
"""

_FEW_CLIPPED = 3
"""Clipped samples up to this number cannot be told from outliers."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """A case's key and the answer to it.

    Parameters
    ----------
    name : str
        Of the case.
    key : dict
    answer : dict
        Gap JSON; ``{"verdict": "error", "why": …}`` when there was no answer.
    """

    name: str
    key: dict[str, Any]
    answer: dict[str, Any]

    @property
    def kind(self) -> str:
        """Kind of case."""
        return str(self.key["kind"])

    @property
    def truth(self) -> list[str]:
        """Names of the true causes."""
        return [str(effect["effect"]) for effect in self.key["effects"]]

    @property
    def other_names(self) -> set[str]:
        """Effects that are as right an answer as none to the causes outside the library."""
        return {str(effect["named"]) for effect in self.key["effects"] if effect.get("named")}

    @property
    def visible_gap(self) -> float:
        """Visible gap of the first cause, or of all when there is none or more than one."""
        effects = self.key["effects"]
        return float(effects[0]["visible_gap"] if len(effects) == 1 else self.key["visible_gap"])

    @property
    def verdict(self) -> str:
        """Verdict of the answer."""
        return str(self.answer.get("verdict", "error"))

    @cached_property
    def causes(self) -> list[dict[str, Any]]:
        """Causes that the answer names, the first one first; none when it says that there is no gap or no cause."""
        return list(self.answer.get("causes") or []) if self.verdict in (EXPLAINED, PARTLY_EXPLAINED) else []

    @property
    def named(self) -> list[str]:
        """Effects that the answer names."""
        return [str(cause["effect"]) for cause in self.causes]

    @property
    def first(self) -> str:
        """The first cause, or the verdict when no cause is named."""
        return self.named[0] if self.causes else self.verdict

    @cached_property
    def probabilities(self) -> dict[str, float]:
        """The probability in the answer of each hypothesis: the effects, `NO_GAP` and `_NONE`."""
        stated = {cause["effect"]: cause["probability"] for cause in self.causes if "probability" in cause}
        stated |= self.answer.get("probabilities") or {}
        given = {name: float(value) for name, value in stated.items() if value is not None}
        return {_NONE if name.startswith(_NONE) else name: value for name, value in given.items()}

    @cached_property
    def ranked(self) -> list[str]:
        """Effects in the answer's order: the causes that it names, then the others by their probability."""
        others = sorted(self.probabilities.items(), key=lambda item: -item[1])
        effects = [name for name, value in others if value > 0 and name not in (NO_GAP, _NONE)]
        return list(dict.fromkeys(self.named + effects))

    @property
    def first_is_right(self) -> bool:
        """Whether the first cause is a true one, by any of its names."""
        return self.first in {*self.truth, *self.other_names}

    @property
    def first_is_tolerable(self) -> bool:
        """Whether the first cause is a true one, or cannot be told from one."""
        return bool(self.causes) and self.tolerates(self.causes[0])

    def tolerates(self, cause: dict[str, Any]) -> bool:
        """Say whether a cause is a true one or a nested partner of one, by nature or as the answer itself says."""
        name = str(cause["effect"])
        alike = {name, *map(str, cause.get("indistinguishable_from") or [])}
        true = (*self.truth, *self.other_names)
        return any(effect in alike or name in self._partners(effect) for effect in true)

    def _partners(self, effect: str) -> set[str]:
        partners = {other for pair in _PARTNERS if effect in pair for other in pair}
        if effect == "saturation" and self.key["effects"][0]["samples_changed"] <= _FEW_CLIPPED:
            partners.add("outliers")
        if effect == "temperature_drift" and self.key["withheld_channel"] == "temperature":
            partners |= {"bias_jump", "geomagnetic_drift"}
        return partners

    @property
    def place_is_right(self) -> bool:
        """Whether the answer puts the gap where it is, whatever it names."""
        return self._same_place(self.answer.get("where") or {})

    @property
    def place_of_cause_is_right(self) -> bool:
        """Whether the first cause is put where the true one is; without a cause, the gap."""
        return self._same_place(self.causes[0] if self.causes else self.answer.get("where") or {})

    def _same_place(self, place: dict[str, Any]) -> bool:
        return self._place(place.get("sensors") or []) in self._true_places()

    def _true_places(self) -> list[frozenset[str]]:
        effect = self.key["effects"][0]
        places = [self._place(effect["sensors"])]
        if effect["effect"] == "geomagnetic_drift" and not self.key["with_scalar"]:
            # The intensity is held to be constant: all vectors alike, or the reference that stands for the scalar.
            places.append(frozenset({"scalar"}))
        return places

    def _place(self, sensors: list[Any]) -> frozenset[str]:
        place = frozenset(map(str, sensors))
        everywhere = frozenset(map(str, range(1, self.key["sensors"] + 1)))
        return frozenset({"all"}) if place >= everywhere else place

    @cached_property
    def laws(self) -> list[dict[str, Any]]:
        """Laws of the gap that the answer states, the strongest first."""
        return list(self.answer.get("signature") or [])

    def law_is_right(self, cause: int = 0) -> bool:
        """Say whether a stated law is that of a cause, with a place and an axis that it may have: the first of one."""
        laws = self.laws[:1] if len(self.truth) == 1 else self.laws
        return any(self._is_law_of(law, self.key["effects"][cause]) for law in laws)

    def _is_law_of(self, law: dict[str, Any], effect: dict[str, Any]) -> bool:
        places = [self._place(one) for one in [law["sensors"], *(law.get("places") or [])]]
        one_axis = len(effect["axes"]) == 1
        return (
            law["law"] in (effect.get("law") or [])
            and self._place(effect["sensors"]) in places
            and (not one_axis or list(law["axes"]) == list(effect["axes"]))
        )

    @property
    def course_is_right(self) -> bool:
        """Whether the course of the first law is one of the true cause."""
        return bool(self.laws) and self.laws[0]["course"] in (self.key["effects"][0].get("course") or [])

    @property
    def true_axis(self) -> str:
        """The one disturbed axis; nothing when it is not one."""
        effects = self.key["effects"]
        return str(effects[0]["axes"][0]) if len(effects) == 1 and len(effects[0]["axes"]) == 1 else ""

    @property
    def axis_is_right(self) -> bool:
        """Whether the answer names the one disturbed axis and no other."""
        axes = self.causes[0].get("axes") if self.causes else None
        return list(axes or (self.answer.get("where") or {}).get("axes") or []) == [self.true_axis]

    @property
    def amplitude_left(self) -> float:
        """The part of the gap's amplitude that remains by the answer; one when it closes nothing."""
        closed = (self.answer.get("gap") or {}).get("closed")
        return float(max(0.0, 1.0 - (closed or 0.0)) ** 0.5)

    @property
    def stated_gap(self) -> float:
        """The gap that the answer states, in noise floors."""
        return float((self.answer.get("gap") or {}).get("before") or 0.0)

    def forecasts(self) -> list[tuple[float, bool]]:
        """Return every probability in the answer, and whether its hypothesis is true."""
        return [(value, name in self._true_names) for name, value in self.probabilities.items()]

    @property
    def _true_names(self) -> set[str]:
        if self.kind == "outside":
            return self.other_names & {self.first} or {_NONE}
        if not self.truth:
            return {NO_GAP}
        # Without the channel that decides for it, none of what can be told apart is as right.
        return {*self.truth, *self.other_names, *([_NONE] if self.kind == "withheld" else [])}

    @property
    def first_forecast(self) -> tuple[float, bool] | None:
        """The probability of the first answer, and whether it is true."""
        name = {NO_GAP: NO_GAP, UNEXPLAINED: _NONE}.get(self.first, self.first)
        probability = self.probabilities.get(name)
        return None if probability is None else (probability, name in self._true_names)

    @property
    def set_95(self) -> list[str] | None:
        """The 95 % set of causes of the answer; None where it states none."""
        names = self.answer.get("set_95")
        return None if names is None else [str(name) for name in names]

    @property
    def set_holds(self) -> bool:
        """Whether that set contains the truth: the cause, "unknown" for one outside the library, or "no_gap"."""
        true = {NO_GAP} if not self.truth else {*self.truth[:1], *self.other_names}
        if self.kind in ("outside", "withheld"):
            true.add("unknown")
        return bool(true & set(self.set_95 or []))

    def coefficients_held(self) -> list[bool]:
        """Return of each coefficient that key and answer both state whether the answer's 95 % interval holds it."""
        true = {name: value for one in self.key["effects"] for name, value in one.get("coefficients", {}).items()}
        stated = {name: one for cause in self.causes for name, one in (cause.get("parameters") or {}).items()}
        both = [(stated[name], value) for name, value in true.items() if name in stated]
        return [
            abs(one["value"] - value) <= WITHIN_95 * one["standard_error"]
            for one, value in both
            if one.get("standard_error") is not None
        ]

    @property
    def line(self) -> str:
        """Key against answer in one line."""
        truth = " + ".join(map(_cause_in_words, self.key["effects"])) or "nothing"
        answer = " + ".join(map(_cause_in_words, self.causes)) or "no cause"
        conditions = [f"N={self.key['samples']}", f"K={self.key['sensors']}", self.key["motion"]]
        conditions += ["no scalar"] * (not self.key["with_scalar"]) + ["holes"] * self.key["holes"]
        conditions += [f"without {self.key['withheld_channel']}"] * bool(self.key["withheld_channel"])
        where = "/".join(map(str, (self.answer.get("where") or {}).get("sensors") or []))
        why = f" ({self.answer['why']})" if "why" in self.answer else ""
        sizes = f"gap {self.stated_gap:.2g}, left {self.amplitude_left:.0%}"
        return (
            f"{self.name} {self.kind} [{', '.join(conditions)}]: {truth}, gap {self.visible_gap:.2g} → "
            f"{self.verdict}{why}: {answer}, where {where or '–'}, {sizes}"
        )


def _cause_in_words(cause: dict[str, Any]) -> str:
    where = "/".join(map(str, cause.get("sensors") or []))
    axes = "".join(cause.get("axes") or []) if len(cause.get("axes") or []) == 1 else ""
    probability = f" p={cause['probability']:.2f}" if cause.get("probability") is not None else ""
    return f"{cause['effect']}@{where}{axes}{probability}"
