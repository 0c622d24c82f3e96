"""The samples of a run on disk, so that a calibrator that is started anew goes on.

An SQLite file: what is saved at once is there whole or not at all, whenever the process is killed.
"""

import sqlite3
from pathlib import Path

import numpy as np

from tam_calibration.messages.sample_store import StoredSample, Unsaved
from tam_calibration.model.exceptions import InputError
from tam_calibration.results.overwriting import name_aside

_TABLES = """
CREATE TABLE IF NOT EXISTS about (text TEXT);
CREATE TABLE IF NOT EXISTS samples (number INTEGER PRIMARY KEY, stamp_ns INTEGER, time_ns INTEGER, row BLOB);
"""

_NAMES = {"about", "samples"}
"""Of the tables; an SQLite file with others, such as a bag's, is of something else."""

_BESIDE = ("", "-wal", "-shm")
"""Ends of the names of the files that SQLite writes."""


class SampleFile:
    """Samples on disk.

    Parameters
    ----------
    path : Path
        Of the file; it and its folder are made where they are not there.
    about : str
        What the samples are of. A file of something else, or one that is damaged, is set aside: renamed, not changed.

    Attributes
    ----------
    set_aside : Path or None
        Where a file is now that could not be used.

    Raises
    ------
    InputError
        When the file cannot be written.
    """

    def __init__(self, path: Path, about: str) -> None:
        self._path, self._stride = path, 1
        self.set_aside: Path | None = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if not self._opens(about):
                self.set_aside = self._rename()
                self._opens(about)
        except (OSError, sqlite3.Error) as problem:
            raise self._cannot(problem) from problem

    def _opens(self, about: str) -> bool:
        """Open the file, and return whether it is of what it shall be of."""
        self._connection = sqlite3.connect(self._path, isolation_level=None, check_same_thread=False)
        try:
            tables = {name for (name,) in self._connection.execute("SELECT name FROM sqlite_master")}
            is_usable = tables <= _NAMES and self._holds(about)
        except sqlite3.OperationalError:
            raise
        except sqlite3.DatabaseError:  # damaged, or no such file
            is_usable = False
        if not is_usable:
            self._connection.close()
        return is_usable

    def _holds(self, about: str) -> bool:
        """Make what is missing, and return whether the samples are of what they shall be of."""
        self._connection.execute("PRAGMA journal_mode = WAL")
        self._connection.execute("PRAGMA synchronous = NORMAL")
        self._connection.executescript(_TABLES)
        [found] = self._connection.execute("SELECT text FROM about").fetchone() or [None]
        if found is None:
            self._connection.execute("INSERT INTO about VALUES (?)", (about,))
        return found in (None, about)

    def _rename(self) -> Path:
        aside = name_aside(self._path)
        for end in _BESIDE:
            if (part := Path(f"{self._path}{end}")).exists():
                part.rename(f"{aside}{end}")
        return aside

    def read(self) -> list[StoredSample]:
        """Return the samples in the order of their numbers.

        Raises
        ------
        InputError
            When the file cannot be read.
        """
        try:
            rows = self._connection.execute("SELECT number, stamp_ns, time_ns, row FROM samples ORDER BY number")
            samples = [StoredSample(*each)._replace(row=np.frombuffer(each[-1])) for each in rows]
        except sqlite3.Error as problem:
            raise self._cannot(problem) from problem
        self._stride = samples[1].number if len(samples) > 1 else 1
        return samples

    def save(self, changed: Unsaved) -> None:
        """Save what has changed in the store, at once.

        Parameters
        ----------
        changed : Unsaved
            Samples that are new, and which of the others are given up.

        Raises
        ------
        InputError
            When the file cannot be written; it is then as it was.
        """
        try:
            with self._connection:
                self._connection.execute("BEGIN")
                if changed.begins:
                    self._connection.execute("DELETE FROM samples")
                elif changed.stride != self._stride:
                    self._connection.execute("DELETE FROM samples WHERE number % ?", (changed.stride,))
                rows = [(*sample[:3], sample.row.tobytes()) for sample in changed.samples]
                self._connection.executemany("INSERT INTO samples VALUES (?, ?, ?, ?)", rows)
        except sqlite3.Error as problem:
            raise self._cannot(problem) from problem
        self._stride = changed.stride

    def close(self) -> None:
        """End writing."""
        self._connection.close()

    def _cannot(self, problem: Exception) -> InputError:
        return InputError(f"samples cannot be kept in {self._path}: {problem}; name another samples_file, or none")
