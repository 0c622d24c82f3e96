"""What a score reads of the answer to a case: a part of what ``tam diagnose --json`` writes."""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal


@dataclass(frozen=True)
class _Parameter:
    may_hold_more: ClassVar = True

    value: float | None
    standard_error: float | None = None


@dataclass(frozen=True)
class _Place:
    may_hold_more: ClassVar = True

    sensors: list[Any] | None = None
    axes: list[str] | None = None


@dataclass(frozen=True)
class _Cause:
    may_hold_more: ClassVar = True

    effect: str
    probability: float | None = None
    sensors: list[Any] | None = None
    axes: list[str] | None = None
    indistinguishable_from: list[str] | None = None
    parameters: dict[str, _Parameter] | None = None


@dataclass(frozen=True)
class _Size:
    may_hold_more: ClassVar = True

    before: float | None = None
    closed: float | None = None


@dataclass(frozen=True)
class _Law:
    may_hold_more: ClassVar = True

    law: str
    course: str
    sensors: list[Any]
    axes: list[str]
    places: list[list[Any]] | None = None


@dataclass(frozen=True)
class Answer:
    """The keys of an answer with their types; ``{"verdict": "error", "why": …}`` is one too."""

    may_hold_more: ClassVar = True

    verdict: Literal["no_gap", "explained", "partly_explained", "unexplained", "not_identifiable", "error"]
    causes: list[_Cause] | None = None
    probabilities: dict[str, float | None] | None = None
    where: _Place | None = None
    gap: _Size | None = None
    set_95: list[str] | None = None
    signature: list[_Law] | None = None
