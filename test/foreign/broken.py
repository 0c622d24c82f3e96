"""Four recordings with faults of drivers and counters, under the package's own names."""

import numpy as np
from foreign.record import UNWRAPPED, Foreign
from foreign.truth import SAMPLES, START_S


def write_table(path, time_s, table_nT, time_form="%.3f"):
    """Write time, twelve axes and scalar as this package names its columns."""
    names = ["time_s", *(f"b{sensor}{axis}_nT" for sensor in (1, 2, 3, 4) for axis in "xyz"), "scalar_nT"]
    form = [time_form, *["%.7g"] * 12, "%.8g"]
    np.savetxt(path, np.column_stack([time_s, table_nT]), form, ",", header=",".join(names), comments="")


def half_rate(path, truth):
    """Write NaN in every second row of sensor 2, whose driver has half the rate of the others."""
    table = truth.table_nT.copy()
    table[1::2, 3:6] = np.nan
    write_table(path, START_S + truth.time_s, table)


def dummies(path, truth):
    """Write zeros for a tenth of sensor 3 and for the scalar without lock, 1e300 where sensor 4 did not answer."""
    table = truth.table_nT.copy()
    rng = np.random.default_rng(11)
    table[rng.permutation(SAMPLES)[: SAMPLES // 10], 6:9] = 0
    table[rng.permutation(SAMPLES)[: SAMPLES // 20], 12] = 0
    table[rng.permutation(SAMPLES)[: SAMPLES // 30], 9:12] = 1e300
    write_table(path, START_S + truth.time_s, table)


def whole_seconds(path, truth):
    """Write times without fractions of a second, so that each stands 25 times."""
    write_table(path, np.floor(START_S + truth.time_s), truth.table_nT, "%d")


def wrap_around(path, truth):
    """Write x and y of sensor 3 as a counter of 16 bits and 1 nT, which overflows at ±32768 nT."""
    table = truth.table_nT.copy()
    table[:, 6:8] = (np.round(table[:, 6:8]) + 2**15) % 2**16 - 2**15
    write_table(path, START_S + truth.time_s, table)


BROKEN = [
    Foreign("half_rate.csv", half_rate),
    Foreign("dummies.csv", dummies),
    Foreign("whole_seconds.csv", whole_seconds),
    Foreign("wrap_around.csv", wrap_around, UNWRAPPED),
]
