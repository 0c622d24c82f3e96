"""One law of a gap, as the answer states it, and the causes that can make it."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

from tam_calibration.effects.effect import read_causes
from tam_calibration.effects.library import effect_named
from tam_calibration.model.exceptions import sensors_in_words
from tam_calibration.model.units import FloatArray

Place = tuple[int | str, ...]
"""Numbers of sensors from 1, "scalar", or "attitude"."""

SCALAR: Place = ("scalar",)
ATTITUDE: Place = ("attitude",)

FREE: frozenset[str] = frozenset({"step", "episodes", "slow", "random"})
"""Courses of any function of time."""

CHANCE: frozenset[str] = frozenset({"noise", "samples"})
"""Laws of which no sample tells another."""


@dataclass(frozen=True, eq=False)
class Course:
    """How the size of a law goes with time.

    Parameters
    ----------
    time_s : (B,) array
        Time stamps, seconds.
    size, error : (B,) array
        Size along the direction in which the readings are shifted most, with its standard error.
    unit : str
        Of the size: "T", or "1" for a part of the field.
    """

    time_s: FloatArray
    size: FloatArray
    error: FloatArray
    unit: str


@dataclass(frozen=True, eq=False)
class Signature:
    """One law of a gap.

    Parameters
    ----------
    law, course : str
        What the disturbance does to a reading, and how its size goes with time.
    sensors, axes : tuple
        Where.
    energy : float
        Share of the gap that it explains out of sample.
    places : tuple of tuple
        Every set of sensors in which it may sit as far as the data tell, the likeliest first.
    follows : str, optional
        A recorded channel, "motion", "attitude", a frequency; None where nothing that was recorded goes with it.
    times_s : tuple of float
        Times of steps, or begin and end of each episode.
    evidence : float
        Log odds against no law.
    curve : Course, optional
        The course with its error.
    """

    law: str
    course: str
    sensors: Place
    axes: tuple[str, ...]
    energy: float
    places: tuple[Place, ...]
    follows: str | None
    times_s: tuple[float, ...]
    evidence: float
    curve: Course | None = None

    @property
    def is_common(self) -> bool:
        """Whether the residual of the intensity alone shows it: an error of the scalar, or a field at all sensors."""
        return not self.axes

    def is_apart_from(self, laws: Iterable["Signature"]) -> bool:
        """Say whether it sits in no sensor in which one of some laws may sit."""
        own = {one for place in self.places for one in place}
        return own.isdisjoint(one for law in laws for place in law.places for one in place)

    def as_made_by(self, effect: str) -> "Signature":
        """Return the law as that of the effect that leaves nothing of it.

        A free course of time imitates what goes with a slow motion, and noise whatever is not predicted. Then the law
        and the course are the usual ones of the effect; those of an effect of a channel follow the channel.

        Parameters
        ----------
        effect : str
            Name of the effect; the table need not hold it.
        """
        cause = next((one for one in CAUSES if one.name == effect), None)
        if cause is None:
            return self
        is_chance = self.law in CHANCE and cause.law[0] not in CHANCE
        is_makeable = self.law in cause.law and not is_chance
        if "channel" in cause.course and cause.channel not in ("", "any"):
            name = self.law if is_makeable else cause.law[0]
            return replace(self, law=name, course="channel", follows=cause.channel)
        if is_makeable and self.course in cause.course:
            return self
        name, course = cause.law[0], cause.course[0]
        curve = self.curve if name == self.law else None
        return replace(self, law=name, course=course, follows="motion" if course == "motion" else None, curve=curve)

    def at_place(self, sensors: Place, axes: tuple[str, ...]) -> "Signature":
        """Return the law at the place of its cause, where that is the scalar, one of its sensors, or all and more.

        Of several sensors those in which a cause is small are left out. What several sensors have shows at the scalar
        too, and some of what the scalar has looks like a field at all sensors.

        Parameters
        ----------
        sensors, axes : tuple
            Where the cause acts.
        """
        shows = {*sensors, *(SCALAR if len(sensors) > 1 else ())}
        is_one = len(sensors) == 1 and (sensors[0] in self.sensors or sensors == SCALAR)
        law = self
        if (is_one or shows >= set(self.sensors)) and sensors not in self.places:
            axes_there = () if sensors == SCALAR else self.axes or axes
            law = replace(self, sensors=sensors, places=(sensors,), axes=axes_there)
        return replace(law, axes=axes) if sensors == law.sensors and axes and set(axes) <= set(law.axes) else law


def in_words(places: Sequence[Place], sensor_count: int, is_common: bool) -> str:
    """Return places in words, joined by "or".

    Parameters
    ----------
    places : sequence of Place
    sensor_count : int
        Number of sensors K.
    is_common : bool
        Whether all sensors feel it alike.
    """
    found = {_one_in_words(place, sensor_count, is_common): place for place in places}
    return ", or ".join(sorted(found, key=lambda words: found[words] != SCALAR) if is_common else found)


def _one_in_words(place: Place, sensor_count: int, is_common: bool) -> str:
    if is_common and place not in (SCALAR, ATTITUDE):
        return "the field at all sensors alike"
    return sensors_in_words(place, sensor_count)


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
        kind = "scalar" if place == SCALAR else "one" if len(place) == 1 else "several"
        return not self.sensors or kind in self.sensors


def _read() -> tuple[PossibleCause, ...]:
    causes = []
    for name, known in read_causes(__file__).items():
        if "title" not in known:
            effect = effect_named(name)
            known |= {"title": effect.title, "physics": effect.physics}
        causes.append(PossibleCause(name, **known))
    return tuple(causes)


CAUSES = _read()
"""All causes that are known, ours and those of which there is no simulation."""


def causes_of(law: Signature, named: Collection[str] = ()) -> tuple[PossibleCause, ...]:
    """Return the causes that can make a law.

    First come those that an answer names, then those whose channel the law follows; others are in the table's order.

    Parameters
    ----------
    law : Signature
    named : collection of str
        Effects that the answer names.
    """
    agreeing = [one for one in CAUSES if one.agrees_with(law)]

    def rank(one: PossibleCause) -> tuple[bool, bool]:
        return one.name not in named, not one.channel or one.channel != law.follows

    return tuple(sorted(agreeing, key=rank))


def acts_at(effect: str, place: Place) -> bool:
    """Say whether an effect acts at a place; True for one that the table does not hold."""
    return all(one.acts_at(place) for one in CAUSES if one.name == effect)


def makes(effect: str, law: Signature) -> bool:
    """Say whether an effect does to a reading what a law says; True for one that the table does not hold."""
    return all(law.law in one.law for one in CAUSES if one.name == effect)


def may_make(effect: str, law: Signature) -> bool:
    """Say whether an effect can make a law whose course may be another that looks alike.

    What follows a recorded channel is no other course: only an effect of that channel can make it. Nor is noise that
    goes with the motion.
    """
    is_certain = law.course == "channel" or (law.law, law.course) == ("noise", "motion")
    return agrees(effect, law) if is_certain else makes(effect, law)


def usual_law(effect: str) -> str:
    """Return the usual law of an effect; empty for one that the table does not hold."""
    return next((one.law[0] for one in CAUSES if one.name == effect), "")


def agrees(effect: str, law: Signature) -> bool:
    """Say whether an effect can make a law with its course and place; True for one that the table does not hold."""
    return all(one.agrees_with(law) for one in CAUSES if one.name == effect)
