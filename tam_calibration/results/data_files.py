"""Recordings and corrected data as files: CSV, or bags."""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tam_calibration.correction.calibration import Calibration
from tam_calibration.correction.parts import Corrected
from tam_calibration.correction.streaming import ContradictionSearch, PartialCorrection
from tam_calibration.files.schema import nanotesla_to_write
from tam_calibration.files.text_files import write_whole
from tam_calibration.messages.point_cloud import SampleLayout
from tam_calibration.messages.samples import Progress, stamps_of
from tam_calibration.model.array import OUTPUT_NAMES, Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.libraries import require
from tam_calibration.model.recording import BLOCK, Recording
from tam_calibration.model.units import FloatArray, IntArray
from tam_calibration.recordings.bag_storages import DEFAULT, is_bag
from tam_calibration.recordings.channel_map import AS_IT_IS, Reading
from tam_calibration.recordings.recording_file import read_pieces, read_samples


def _write_blocks(path: Path, names: Sequence[str], blocks: Iterable[FloatArray]) -> None:
    """Write a table of blocks of rows, with the shortest decimals that read back as the same numbers."""
    with write_whole(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(names) + "\n")
        for rows in blocks:
            file.writelines(",".join(map(repr, row)) + "\n" for row in np.asarray(rows, dtype=float).tolist())


def write_csv_recording(path: Path, recording: Recording) -> None:
    """Write a recording with its fields in nT.

    Parameters
    ----------
    path : Path
        The CSV file; one that is there is replaced once the new one is complete.
    recording : Recording
        A channel that it lacks has no column; NaN is written as nan.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    layout = SampleLayout.of(recording)
    rows = layout.rows(recording)
    is_field = [name.endswith("_T") for name in layout.columns]
    rows[:, is_field] = nanotesla_to_write(rows[:, is_field])
    names = [re.sub("_T$", "_nT", name) for name in layout.columns]
    _write_blocks(path, names, (rows[start : start + BLOCK] for start in range(0, len(rows), BLOCK)))


OUTPUT_COLUMNS = tuple(f"{name}_nT" if name.startswith("b") else f"{name}_nT_per_m" for name in OUTPUT_NAMES)
"""Names of the nine outputs with their units."""


def write_recording(path: Path, recording: Recording, storage: str = DEFAULT) -> None:
    """Write a recording: CSV for the suffix .csv, a single mcap file for .mcap, else a bag's folder.

    Parameters
    ----------
    path : Path
        Where to write.
    recording : Recording
        The samples.
    storage : str
        What a bag's folder contains: a name in ``bag_storages.STORAGES``.

    Raises
    ------
    InputError
        When it cannot be written.
    """
    path = Path(path)
    if path.suffix == ".csv":
        write_csv_recording(path, recording)
    else:
        require("bags", "writing bags")
        from tam_calibration.recordings.bag_writing import write_bag_recording

        write_bag_recording(path, recording, storage)


def write_corrected_pieces(
    path: Path,
    pieces: Iterable[tuple[Corrected, IntArray | None]],
    source: Path | None = None,
    progress: Progress = lambda done, total: None,
    how: Reading = AS_IT_IS,
    array: Array | None = None,
) -> None:
    """Write corrected data piece by piece: CSV for the suffix .csv, a single mcap file for .mcap, else a bag's folder.

    A CSV has the centre vector in nT and the gradient tensor in nT/m, nan where there is no gradient; one that is there
    is replaced once the new one is complete.

    Parameters
    ----------
    path : Path
        Where to write.
    pieces : iterable of (Corrected, (N,) array of int)
        Results with the stamps of the messages they came from, nanoseconds; None for the results' times.
    source : Path, optional
        The recording they came from. When it is a bag, a bag that is written carries its other topics too and has the
        same storage.
    progress : callable
        Called now and then with the bytes of a source bag that were carried over, and how many there are.
    how : Reading
        How the source was read.
    array : Array, optional
        Of which array.

    Raises
    ------
    InputError
        When it cannot be written.
    """
    path = Path(path)
    if path.suffix == ".csv":
        blocks = (np.column_stack([piece.time_s, nanotesla_to_write(piece.outputs)]) for piece, _ in pieces)
        _write_blocks(path, ("time_s", *OUTPUT_COLUMNS), blocks)
    else:
        require("bags", "writing bags")
        from tam_calibration.results.bag_corrected import write_bag_corrected

        stamped = ((each, stamps_of(each.time_s) if stamps is None else stamps) for each, stamps in pieces)
        write_bag_corrected(path, stamped, source if source and is_bag(source) else None, progress, how, array)


def correct_file(
    path: Path, calibration: Calibration, how: Reading = AS_IT_IS, progress: Progress = lambda done, total: None
) -> Iterator[tuple[Corrected, IntArray | None]]:
    """Yield the corrected pieces of a recording with the stamps of its messages; None where it is a CSV file.

    Samples that lack a sensor, or of which one contradicts all others, are corrected with the others.

    Parameters
    ----------
    path : Path
        The bag or CSV file.
    calibration : Calibration
        What to correct with; where it contains effects, the complete recording is one piece.
    how : Reading
        How it is read.
    progress : callable
        Called now and then with the bytes read of a bag, and how many there are; not of a CSV file.

    Raises
    ------
    InputError
        When it cannot be read, and at the end when it is mostly not in tesla.
    """
    source = path, calibration.array, replace(how, with_partial=True), progress
    partial, failing = PartialCorrection(calibration), ContradictionSearch(calibration)
    # Effects reach from one piece into the next, and holes in their channels are filled from both sides.
    pieces = [read_samples(*source)] if calibration.effects else read_pieces(*source)
    wrong_units: list[InputError] = []
    right_units = 0
    for samples in pieces:
        codes = failing.codes_of(samples.recording.time_s, samples.recording.readings_T)
        codes |= 0 if samples.missing is None else samples.missing
        corrected = partial.correct(samples.recording, codes)
        # What a sensor that is left out reads has no unit to check.
        sound = replace(samples.recording, readings_T=partial.filled(samples.recording.readings_T, codes))
        clean = calibration.without_effects(sound) if calibration.effects else sound
        try:
            sound.check_units(calibration.array.field)
            right_units += 1
        except InputError as problem:
            wrong_units.append(problem)
        remarks = (*samples.usage.missing, *failing.sentences())
        yield replace(corrected, scalar_T=clean.scalar_T, remarks=remarks), samples.stamps_ns
    if len(wrong_units) > right_units:
        raise wrong_units[0]
