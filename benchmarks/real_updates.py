"""Whether standard errors of real recordings hold: calibrations of one sensor of several days, and their updates.

Run ``python benchmarks/real_updates.py RECORDING RECORDING … ARRAY [--white]``; all recordings are of one sensor. A
calibration of each, and one by ``robust``, tells scale factors and angles, which do not change from day to day: their
differences over their standard errors are counted. Then each third of each recording updates the calibration of each
other one (``tam calibrate --prior``), and all nine parameters are compared with those of the other two thirds: how
often the 95 % intervals hold, how often a sensor is said to have moved, though biases may change by
``--bias-nT-per-day``, and how often the update is refused. ``--white`` takes residuals for white noise.
"""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, permutations
from pathlib import Path
from unittest.mock import patch

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from tam_calibration.core.noise import SlowSums
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit import calibrate
from tam_calibration.model.array import Array
from tam_calibration.model.data_sheet import ChangeRates
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray, from_nanotesla
from tam_calibration.recordings import read_array, read_recording
from tam_validation.blind.rates import WITHIN_95, Rate

THIRDS = 3
"""Parts of a recording that update a calibration: turns of some seconds of a phone, in no full circle."""

STEADY, ALL = slice(6), slice(9)
"""Scale factors and angles of a sensor, and these with its biases."""


def pulls(one: Calibration, other: Calibration, chosen: slice) -> FloatArray:
    """Return the differences of two independent calibrations over their standard errors."""
    difference = (one.errors.to_vector() - other.errors.to_vector())[0, chosen]
    deviation: FloatArray = np.hypot(one.standard_errors[0, chosen], other.standard_errors[0, chosen])
    return difference / deviation


def updates(prior: Calibration, recording: Recording, array: Array) -> Iterator[tuple[Calibration, Calibration] | None]:
    """Yield each third's update of a prior, with the calibration of the other two; None where it is refused."""
    part = np.arange(recording.sample_count) * THIRDS // recording.sample_count
    for third in range(THIRDS):
        try:
            update = calibrate(recording.take(part == third), array, prior=prior)
        except (InputError, Refused) as problem:
            click.echo(f"refused: {problem}")
            yield None
            continue
        yield update, calibrate(recording.take(part != third), array)


def row(what: str, found: list[FloatArray]) -> tuple[str, ...]:
    """Return how many intervals hold, and the size of the pulls."""
    all_of_them = np.concatenate([*found, np.empty(0)])
    rate = Rate.of(np.abs(all_of_them) <= WITHIN_95)
    low, high = rate.interval
    rms = float(np.sqrt(np.mean(all_of_them**2))) if rate.cases else np.nan
    return what, str(rate.cases), f"{rate.value:.1%}", f"{low:.1%} – {high:.1%}", f"{rms:.2f}"


@click.command(help=__doc__)
@click.argument("paths", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True))
@click.option("--bias-nT-per-day", "bias_nT", default=2000.0, show_default=True)
@click.option("--white", is_flag=True)
def main(paths: tuple[Path, ...], bias_nT: float, white: bool) -> None:
    """Count, and print a table."""
    if white:
        patch("tam_calibration.fit.estimate._slow_sums", lambda *_: [SlowSums(), SlowSums()]).start()
    *of_recordings, of_array = paths
    array = replace(read_array(of_array), change_rates=ChangeRates(bias_per_day=from_nanotesla(bias_nT)))
    recordings = {path.stem: read_recording(path) for path in of_recordings}
    calibrations = {name: calibrate(recording, array) for name, recording in recordings.items()}
    counts, found = defaultdict[str, int](int), list[FloatArray]()
    for before, now in permutations(recordings, 2):
        for answer in updates(calibrations[before], recordings[now], array):
            counts["updates"] += 1
            counts["refused"] += answer is None
            if answer is not None:
                counts["a sensor has moved"] += bool(answer[0].update and answer[0].update.moved)
                found.append(pulls(*answer, ALL))
    table = Table("what", "parameters", "within 95 %", "95 % interval of that", "errors over standard errors, rms")
    robust = {name: calibrate(recording, array, "robust") for name, recording in recordings.items()}
    for kind, of_kind in (("calibrations", calibrations), ("robust calibrations", robust)):
        steady = [pulls(one, other, STEADY) for one, other in combinations(of_kind.values(), 2)]
        table.add_row(*row(f"{kind} of each other", steady))
    table.add_row(*row("updates of the other thirds", found))
    console = Console(width=140)
    console.print(table)
    console.print(dict(counts))


if __name__ == "__main__":
    main()
