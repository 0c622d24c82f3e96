"""What a command runs in, and how it is ended."""

import signal
from collections.abc import Mapping
from dataclasses import dataclass, field

NOBODY = 65534
"""User and group that may write nothing, for a battery that root runs."""


@dataclass(frozen=True)
class Surroundings:
    """What a command runs in.

    Parameters
    ----------
    fresh : bool
        Whether an interpreter of its own is started, instead of a fork of one that has everything imported: for what
        an interpreter settles when it begins.
    variables : mapping
        Of the environment; None takes one away.
    stdout : str
        ``closed``, ``broken`` (a pipe whose reader goes), or the path of a device; empty: a file.
    stderr, stdin : str
        The same, without ``broken``.
    read_bytes : int
        What the reader of a broken pipe takes before it goes.
    limits : mapping
        Of resources (``resource.RLIMIT_…``) in the process.
    disk_bytes : int or None
        Size of a file system that is mounted on the folder ``new`` of the case; None: none is.
    is_nobody : bool
        Whether the process gives up the rights of root.
    within : str
        Folder below that of the case in which the command is called.
    loses_folder : bool
        Whether that folder is removed just before the command begins.
    ended_by : Signals or None
        Sent to the process.
    moment : float
        When it is sent, as a part of the time that the command takes undisturbed.
    """

    fresh: bool = False
    variables: Mapping[str, str | None] = field(default_factory=dict)
    stdout: str = ""
    stderr: str = ""
    stdin: str = ""
    read_bytes: int = 0
    limits: Mapping[int, int] = field(default_factory=dict)
    disk_bytes: int | None = None
    is_nobody: bool = False
    within: str = "."
    loses_folder: bool = False
    ended_by: signal.Signals | None = None
    moment: float = 0.0


PLAIN = Surroundings()


@dataclass(frozen=True)
class Ended:
    """How a command ended.

    Parameters
    ----------
    code : int
        As a shell has it: 128 and the signal's number where a signal ended it.
    died : bool
        Whether it was a signal that ended it.
    stdout, stderr : str
        What it said.
    seconds : float
        From beginning to end.
    memory_bytes : int
        Largest resident memory.
    is_hung : bool
        Whether it had to be killed.
    left_running : tuple of str
        Processes that it left, which went on for seconds.
    """

    code: int
    died: bool
    stdout: str
    stderr: str
    seconds: float
    memory_bytes: int
    is_hung: bool = False
    left_running: tuple[str, ...] = ()
