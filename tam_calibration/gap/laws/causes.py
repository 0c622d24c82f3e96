"""Causes by their signatures: what can make a law, in order."""

import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tam_calibration.effects.library import effect_named
from tam_calibration.gap.laws.law import CHANCE, Place, Signature


@dataclass(frozen=True)
class PossibleCause:
    """A cause with the signature of a law.

    Parameters
    ----------
    name : str
        Of an effect of the library, or of a cause without simulation.
    title, physics : str
        What it is, and why, with a source.
    law, course : tuple of str
        Its laws and their courses.
    proof, remedy : str
        What would prove it, and what to do about it.
    channel : str
        The recorded channel that goes with it, where there is one; "any" where several may.
    sensors : tuple of str
        "one", "several" and "scalar": where it acts; empty for any place.
    size : str
        In nature, where no effect of the library states it.
    """

    name: str
    title: str
    physics: str
    law: tuple[str, ...]
    course: tuple[str, ...]
    proof: str
    remedy: str
    channel: str = ""
    sensors: tuple[str, ...] = ()
    size: str = ""

    def agrees_with(self, law: Signature) -> bool:
        """Say whether it can make a law: what it does to a reading, its course, one of its places."""
        if law.law not in self.law or law.course not in self.course:
            return False
        if law.course == "channel" and self.channel not in ("any", law.follows):
            return False
        return any(self.acts_at(place) for place in law.places)

    def acts_at(self, place: Place) -> bool:
        """Say whether it acts at a place."""
        return not self.sensors or _kind(place) in self.sensors


def _kind(place: Place) -> str:
    return "scalar" if place == ("scalar",) else "one" if len(place) == 1 else "several"


def _read() -> tuple[PossibleCause, ...]:
    table = tomllib.loads(Path(__file__).with_name("causes.toml").read_text(encoding="utf-8"))
    causes = []
    for name, entry in table.items():
        known: dict[str, Any] = {
            key: tuple(value) if isinstance(value, list) else value for key, value in entry.items()
        }
        if "title" not in known:
            effect = effect_named(name)
            known |= {"title": effect.title, "physics": effect.physics}
        causes.append(PossibleCause(name, **known))
    return tuple(causes)


CAUSES = _read()
"""All causes that are known, ours and those of which there is no simulation."""


def causes_of(law: Signature) -> tuple[PossibleCause, ...]:
    """Return the causes that can make a law: first those whose channel it follows, then in the order of the table."""
    agreeing = [one for one in CAUSES if one.agrees_with(law)]
    return tuple(sorted(agreeing, key=lambda one: not (one.channel and one.channel == law.follows)))


def acts_at(effect: str, place: Place) -> bool:
    """Say whether an effect acts at a place; True for one that the table does not hold."""
    return all(one.acts_at(place) for one in CAUSES if one.name == effect)


def makes(effect: str, law: Signature) -> bool:
    """Say whether an effect does to a reading what a law says; True for one that the table does not hold."""
    return all(law.law in one.law for one in CAUSES if one.name == effect)


def may_make(effect: str, law: Signature) -> bool:
    """Say whether an effect can make a law whose course may be another that looks alike.

    What follows a recorded channel is no other course: only an effect of that channel can make it.
    """
    return agrees(effect, law) if law.course == "channel" else makes(effect, law)


def as_made_by(effect: str, law: Signature) -> Signature:
    """Return a law as that of the effect that leaves nothing of it.

    A free course of time imitates what goes with a slow motion, and noise whatever is not predicted. Then the law and
    the course are the usual ones of the effect; those of an effect of a channel follow the channel.

    Parameters
    ----------
    effect : str
        Name of the effect; the table need not hold it.
    law : Signature
        As it was found.
    """
    cause = next((one for one in CAUSES if one.name == effect), None)
    if cause is None:
        return law
    is_chance = law.law in CHANCE and cause.law[0] not in CHANCE
    name = law.law if law.law in cause.law and not is_chance else cause.law[0]
    if "channel" in cause.course and cause.channel not in ("", "any"):
        return replace(law, law=name, course="channel", follows=cause.channel)
    if name == law.law and law.course in cause.course:
        return law
    course, curve = cause.course[0], law.curve if name == law.law else None
    return replace(law, law=name, course=course, follows="motion" if course == "motion" else None, curve=curve)


def goes_with_the_rate(effect: str) -> bool:
    """Say whether the usual law of an effect is one of the field's rate of change."""
    return any(one.law[0] == "rate" for one in CAUSES if one.name == effect)


def agrees(effect: str, law: Signature) -> bool:
    """Say whether an effect can make a law with its course and place; True for one that the table does not hold."""
    return all(one.agrees_with(law) for one in CAUSES if one.name == effect)
