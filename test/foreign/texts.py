"""Eight text recordings as loggers and other programs write them."""

from datetime import UTC, datetime

import numpy as np
from foreign.record import DIRECT, INSPECTED, MAPPED, Foreign
from foreign.truth import SAMPLES, START_S

LSB_NT = 0.15
"""Size of a count of the raw converter, nT."""

BOOT_US = 2**32 - 40_000_000
"""What the microcontroller's clock shows at the first sample, µs: it starts again from 0 after 40 s."""


def write(path, preamble, rows, end="\n", encoding="utf-8"):
    """Write lines of text: a preamble with the header, then the rows."""
    lines = [*preamble, *rows]
    path.write_bytes((end.join(lines) + end).encode(encoding))


def joined(separator, *columns):
    """Yield rows of cells that are texts already."""
    return (separator.join(cells) for cells in zip(*columns, strict=True))


def formatted(form, values):
    """Return numbers (N,) or (N, columns) as columns of texts."""
    return [[form % value for value in column] for column in np.atleast_2d(np.asarray(values).T)]


def axes(pattern):
    """Return the names of twelve columns, sensor by sensor."""
    return [pattern.format(sensor=sensor, axis=axis) for sensor in (1, 2, 3, 4) for axis in "xyz"]


def dates(time_s, form):
    """Return UTC times as texts with milliseconds; the form says ``%f`` where they go."""
    times = (datetime.fromtimestamp(round(START_S + second, 3), UTC) for second in time_s)
    return [time.strftime(form.replace("%ms", f"{time.microsecond // 1000:03d}")) for time in times]


def european(path, truth):
    """Write semicolons, decimal commas and µT in the code page of Windows, with its ends of lines."""
    names = ["Zeit [s]", *axes("B{sensor}{axis} [µT]"), "Gesamtfeld [µT]"]
    columns = formatted("%.2f", truth.time_s) + formatted("%.4f", 1e-3 * truth.table_nT)
    rows = (row.replace(".", ",") for row in joined(";", *columns))
    write(path, [";".join(names)], rows, "\r\n", "cp1252")


def tabs(path, truth):
    """Write tabs after a preamble of comments."""
    preamble = ["# Fluxgate array, firmware 2.1", "# rate 25 Hz, values in nT", "#", "# operator: A. N. Other"]
    names = ["t", *axes("B{sensor}{axis}"), "total"]
    rows = joined("\t", *formatted("%.3f", truth.time_s), *formatted("%.2f", truth.table_nT))
    write(path, [*preamble, "\t".join(names)], rows)


def data_frame_of_r(path, truth):
    """Write what ``write.csv`` of R does: quoted names, and quoted numbers of rows under a name that is empty."""
    names = ["", "elapsed", *axes("mag{sensor}.{axis}"), "F"]
    numbers = [f'"{number}"' for number in range(1, SAMPLES + 1)]
    rows = joined(",", numbers, *formatted("%.6g", truth.time_s), *formatted("%.9g", truth.table_nT))
    write(path, [",".join(f'"{name}"' for name in names)], rows)


def iso8601(path, truth):
    """Write a logger's free text, then ISO 8601 times and names with units."""
    preamble = ["Survey export", "Station: Hill 3, array A", "Created 14/05/2024, 10:02 by LogView 7", ""]
    names = ["Timestamp", *axes("Mag{sensor}_{axis} [nT]"), "Scalar [nT]"]
    rows = joined(", ", dates(truth.time_s, "%Y-%m-%dT%H:%M:%S.%msZ"), *formatted("%.2f", truth.table_nT))
    write(path, [*preamble, ", ".join(names)], rows)


def no_header(path, truth):
    """Write numbers alone, separated by blanks of different length: Unix time, sensors, scalar."""
    rows = joined(" ", *formatted("%.3f", START_S + truth.time_s), *formatted("%10.2f", truth.table_nT))
    write(path, [], rows)


def counts(path, truth):
    """Write the raw counts of a converter without any time, and the scalar in nT."""
    names = [*(f"ch{number:02d}" for number in range(12)), "cs_nT"]
    raw = np.round(truth.table_nT[:, :12] / LSB_NT)
    write(path, [",".join(names)], joined(",", *formatted("%d", raw), *formatted("%.3f", truth.table_nT[:, 12])))


def counter(path, truth):
    """Write the clock of a microcontroller, µs in 32 bits, which starts again from zero on the way."""
    ticks = (BOOT_US + np.round(1e6 * truth.time_s).astype(int)) % 2**32
    names = ["time_us", *axes("m{sensor}{axis}"), "scalar"]
    write(path, [",".join(names)], joined(",", *formatted("%d", ticks), *formatted("%.2f", truth.table_nT)))


def a_file_each(path, truth):
    """Write a folder with a file for each sensor and one for the scalar, with dates and times."""
    path.mkdir()
    times = dates(truth.time_s, "%Y-%m-%d %H:%M:%S.%ms")
    for sensor in range(4):
        readings = formatted("%.2f", truth.table_nT[:, 3 * sensor : 3 * sensor + 3])
        write(path / f"CH{sensor}.csv", ["date time,X,Y,Z"], joined(",", times, *readings))
    write(path / "scalar.csv", ["date time,F"], joined(",", times, *formatted("%.3f", truth.table_nT[:, 12])))


TEXTS = [
    Foreign("european.csv", european),
    Foreign("tabs.txt", tabs),
    Foreign("r.csv", data_frame_of_r),
    Foreign("logger.csv", iso8601),
    Foreign("numbers.dat", no_header, INSPECTED),
    Foreign(
        "counts.csv",
        counts,
        MAPPED,
        map="time: {rate_hz: 25}\nsensors:\n"
        + "".join(
            f"  - {{columns: [ch{k:02d}, ch{k + 1:02d}, ch{k + 2:02d}], scale_nT: {LSB_NT}}}\n" for k in (0, 3, 6, 9)
        )
        + "scalar: {column: cs_nT, unit: nT}\n",
    ),
    Foreign("counter.csv", counter, DIRECT),
    Foreign(
        "cube",
        a_file_each,
        MAPPED,
        map="time: {column: date time}\nsensors:\n"
        + "".join(f"  - {{file: CH{sensor}.csv, columns: [2, 3, 4], unit: nT}}\n" for sensor in range(4))
        + "scalar: {file: scalar.csv, column: F, unit: nT}\n",
    ),
]
