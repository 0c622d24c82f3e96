"""The answer of an inspection: what a recording contains, what is odd about it, and what would be taken of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tam_calibration.model.units import TESLA_PER_FIELD_UNIT, FloatArray, to_nanotesla
from tam_calibration.recordings.channel_map import ChannelMap, map_to_yaml

_NAMES = 6
"""Tables and channels that are named as showing the same: a log has hundreds."""


@dataclass(frozen=True, eq=False)
class Course:
    """The smallest and the largest values of a channel over time.

    Parameters
    ----------
    time_s : (m,) array
        Seconds from the beginning of the recording; rows, where there is no time.
    low, high : (m, width) array
        As they were recorded.
    """

    time_s: FloatArray
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True, eq=False)
class InspectedChannel:
    """A vector, a quaternion or a number of a table.

    Parameters
    ----------
    fields : tuple of str
        Its paths or columns.
    taken_as : str
        Such as ``sensor 1`` or ``scalar``; empty where it is not taken.
    low, high : tuple of float
        Range of each field, without missing readings, as recorded.
    size : float
        Of the magnetic field that it reads, as recorded; NaN of others.
    unit : str
        Of that field, as stated, unless another fits better; empty where it is not known.
    stated_unit : str
        As the format or a name states it; empty where neither does.
    missing : mapping of str to int
        Number of missing readings by their reason.
    oddities : tuple of str
        What is odd, a clause each.
    course : Course
        Over time.
    """

    fields: tuple[str, ...]
    taken_as: str
    low: tuple[float, ...]
    high: tuple[float, ...]
    size: float
    unit: str
    stated_unit: str
    missing: Mapping[str, int]
    oddities: tuple[str, ...]
    course: Course = field(repr=False)

    @property
    def is_unit_stated(self) -> bool:
        """Whether the unit is that which is stated; else it was detected by the size of the field."""
        return self.unit != "" and self.unit == self.stated_unit

    @property
    def nanotesla(self) -> float:
        """How many nT one of its units is; NaN where that is not known."""
        return to_nanotesla(TESLA_PER_FIELD_UNIT[self.unit]) if self.unit else float("nan")

    @property
    def title(self) -> str:
        """Its fields for people: a vector by what its paths have in common."""
        parents = {path.rpartition(".")[0] for path in self.fields}
        return (
            parents.pop()
            if len(self.fields) > 1 and len(parents) == 1 and "" not in parents
            else ", ".join(self.fields)
        )


@dataclass(frozen=True, eq=False)
class InspectedTable:
    """A topic, a message of a log or a text file.

    Parameters
    ----------
    name : str
        Topic or file, with the number of an instance.
    type : str
        Of a topic's messages.
    count : int or None
        Messages or rows; None where it is not known.
    rate_hz : float
        In the mean; NaN where it is not known.
    time : str
        Where its time comes from; empty where it was not read.
    oddities : tuple of str
        What is odd about its times, a clause each.
    channels : tuple of InspectedChannel
        Its vectors, quaternions and numbers; none of images, clouds and unknown types.
    """

    name: str
    type: str
    count: int | None
    rate_hz: float
    time: str
    oddities: tuple[str, ...]
    channels: tuple[InspectedChannel, ...]


@dataclass(frozen=True, eq=False)
class Inspection:
    """What a recording contains, and what would be taken of it.

    Parameters
    ----------
    files : tuple of Path
        What was read.
    format : str
        For people.
    duration_s : float
        From the first to the last message or row; NaN where there is no time.
    tables : tuple of InspectedTable
        Its topics, messages or files.
    channel_map : ChannelMap or None
        The choice, or the best guess; None where nothing can be taken.
    reasons : tuple of str
        What is taken for what, and why.
    doubts : tuple of str
        Why the choice is ambiguous or not enough, with what to add; empty where it can be made.
    remarks : tuple of str
        What is not taken although it may be meant.

    Examples
    --------
    >>> from tam_calibration import inspect, read_scenario, simulate
    >>> simulate(read_scenario("wu_table_1")).recording.to_pandas().to_csv("run.csv")
    >>> found = inspect("run.csv")
    >>> found.is_certain, found.duration_s, len(found.channel_map.sensors), found.oddities
    (True, 359.0, 4, ())
    """

    files: tuple[Path, ...]
    format: str
    duration_s: float
    tables: tuple[InspectedTable, ...]
    channel_map: ChannelMap | None
    reasons: tuple[str, ...]
    doubts: tuple[str, ...]
    remarks: tuple[str, ...]

    @property
    def is_certain(self) -> bool:
        """Whether a choice can be made."""
        return self.channel_map is not None and not self.doubts

    @property
    def oddities(self) -> tuple[str, ...]:
        """What is odd about the complete recording: each clause behind what shows it, first that of what is taken."""
        shown: dict[str, list[tuple[bool, str]]] = {}
        for table in self.tables:
            is_free = not any(channel.taken_as for channel in table.channels)
            for clause in table.oddities:
                shown.setdefault(clause, []).append((is_free, table.name))
            for channel in table.channels:
                name = channel.taken_as or f"{table.name} {channel.title}".strip()
                for clause in channel.oddities:
                    shown.setdefault(clause, []).append((not channel.taken_as, name))
        clauses = [(all(free for free, _ in names), _listed(names), clause) for clause, names in shown.items()]
        clauses.sort(key=lambda each: each[0])
        return tuple(": ".join(filter(None, (names, clause))) for _, names, clause in clauses)

    def map_yaml(self) -> str:
        """Return a map to edit, with what is ambiguous as comments.

        Returns
        -------
        str
            Text of the YAML file. It has no sensors where none is found.
        """
        names = ", ".join(file.name for file in self.files)
        said = [f"What is taken of {names}. Edit it, and give it with --map."]
        said += [f"To settle: {clause}" for clause in (*self.doubts, *self.remarks)]
        text = "sensors: []\n" if self.channel_map is None else map_to_yaml(self.channel_map)
        return "".join(f"# {' '.join(line.split())}\n" for line in said) + text


def _listed(names: Sequence[tuple[bool, str]]) -> str:
    """Return some names, first those of what is taken, and how many more there are."""
    listed = [name for _, name in sorted(names, key=lambda each: each[0])]
    more = [f"{len(listed) - _NAMES} more"] if len(listed) > _NAMES else []
    return ", ".join([*listed[:_NAMES], *more])
