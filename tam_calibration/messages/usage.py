"""How many of sensor 1's samples were used, why not the others, and when that is too few for an answer."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from tam_calibration.messages.stream import Losses, Stream
from tam_calibration.model.exceptions import Refused

_WARNED_BELOW = 0.9
_REFUSED_BELOW = 0.5


@dataclass(frozen=True)
class Usage:
    """How many of sensor 1's samples were used.

    Parameters
    ----------
    used : int
        Samples that all sensors joined.
    received : int
        Messages of sensor 1, but for those that still wait.
    reasons : tuple of str
        Why the others were not used, each with its count and what mends it, the most frequent first.
    """

    used: int
    received: int
    reasons: tuple[str, ...] = ()

    @classmethod
    def of(cls, used: int, first: Stream, others: Sequence[Stream], patience_ns: int) -> "Usage":
        """Return the usage that the streams of the sensors tell.

        Parameters
        ----------
        used : int
            Samples that were made.
        first : Stream
            Of sensor 1.
        others : sequence of Stream
            Of the other sensors.
        patience_ns : int
            How far the stamps of one may lag behind those of another, nanoseconds.
        """
        own = _own_faults(first.losses)
        reasons = [(count, f"{count} {fault}: look at the driver of {first.name}") for count, fault in own]
        newest = max([first, *others], key=lambda stream: stream.timeline.newest_ns)
        for stream in others:
            reasons.append((stream.losses.missing, _why_missing(stream, newest, patience_ns)))
        told = sorted((reason for reason in reasons if reason[0]), key=lambda reason: -reason[0])
        waiting = len(first.buffer) + len(first.timeline.doubtful)
        return cls(used, first.losses.received - waiting, tuple(text for _, text in told))

    @classmethod
    def from_json(cls, text: str) -> "Usage":
        """Return the usage that `to_json` wrote."""
        content = json.loads(text)
        return cls(content["used"], content["received"], tuple(content["reasons"]))

    def to_json(self) -> str:
        """Return the usage as text for other processes."""
        return json.dumps(asdict(self), ensure_ascii=False)

    def __str__(self) -> str:
        """Return the usage as a clause for people."""
        why = f": {'; '.join(self.reasons)}" if self.reasons else ""
        return f"{self.used} of {self.received} samples of sensor 1 used{why}"

    def warnings(self) -> tuple[str, ...]:
        """Return a warning where less than nine tenths were used.

        Raises
        ------
        Refused
            When less than half were used.
        """
        if self.used < _REFUSED_BELOW * self.received:
            raise Refused(f"only {self}; mend that and record again")
        return (f"only {self}",) if self.used < _WARNED_BELOW * self.received else ()

    def remarks(self) -> tuple[str, ...]:
        """Return the warnings as whole sentences.

        Raises
        ------
        Refused
            When less than half were used.
        """
        return tuple(f"{warning[0].upper()}{warning[1:]}." for warning in self.warnings())


def _own_faults(losses: Losses) -> list[tuple[int, str]]:
    return [
        (losses.duplicate, "repeat the stamp before"),
        (losses.late, "have stamps out of order"),
        (losses.implausible, "have false stamps"),
        (losses.unusable, "are damaged, not finite or without time"),
    ]


def _why_missing(stream: Stream, newest: Stream, patience_ns: int) -> str:
    """Return why samples have nothing of a sensor: nothing came, nothing usable, not in time, or not all."""
    losses, name = stream.losses, stream.name
    if not losses.received:
        return f"nothing arrived from {name}: check sensor, cable, driver and topic"
    lacking = f"{losses.missing} found none of {name}"
    if losses.implausible + losses.unusable + losses.duplicate > losses.missing // 2:
        return f"{lacking}, most of whose messages cannot be used: {losses.explain()}"
    behind_ns = newest.timeline.newest_ns - stream.timeline.newest_ns
    if behind_ns > max(patience_ns, stream.timeline.reach_ns):
        behind = f"{behind_ns / 1e9:.3g} s behind that of {newest.name}"
        mend = "it stopped, or their clocks differ; synchronise the clocks, or state delay_s in the array file"
        return f"{lacking}, whose newest stamp is {behind}: {mend}"
    return f"{lacking}, of which {losses.received} messages came: they have gaps, or come too late; look at the load"
