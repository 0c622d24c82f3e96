"""The biases that MAGYC finds next to ours, from the same recordings with a gyroscope and without a scalar.

Run ``python benchmarks/gyroscope_rivals.py [--runs 20] [--seed 1]``, with the package magyc from PyPI installed: the
public code of Rodríguez-Martínez and others (arXiv 2410.13827, 2412.09690).
"""

import click
import numpy as np
from gyroscope import Case, jointly
from numpy.linalg import norm
from rich.progress import track
from spread import Row, show

from tam_calibration.model.units import to_nanotesla

RIVALS = ("magyc_ls", "magyc_nls", "magyc_ifg")
"""Its methods: linear, non-linear, and a factor graph."""


def biases_of(case: Case, seed: int) -> dict[str, float]:
    """Return the error of the bias by each method, nT."""
    try:
        import magyc
    except ImportError:
        raise click.ClickException("MAGYC is not installed: install the package magyc from PyPI") from None

    recording, errors = case.made(seed)
    found = {"this package": jointly(recording, case.array).errors.to_vector()[0, 6:9]}
    for name in RIVALS:
        # In microtesla: its solvers are not scaled.
        data = 1e6 * recording.readings_T[:, 0], recording.angular_velocity_rad_s, recording.time_s
        found[name] = 1e-6 * np.ravel(getattr(magyc, name)(*data)[0])
    return {name: to_nanotesla(float(norm(bias - errors.to_vector()[0, 6:9]))) for name, bias in found.items()}


@click.command(help=__doc__)
@click.option("--runs", default=20, show_default=True, help="Recordings of each case.")
@click.option("--seed", default=1, show_default=True, help="Of the first of them.")
def main(runs: int, seed: int) -> None:
    """Print the figures, and keep them."""
    rows = []
    for case in (Case(tilt_deg=tilt, has_scalar=False) for tilt in (5.0, 30.0)):
        away_nT = [biases_of(case, seed + number) for number in track(range(runs), case.name)]
        for name in away_nT[0]:
            size = float(np.sqrt(np.mean([each[name] ** 2 for each in away_nT])))
            rows.append(Row(case.name, f"RMSE of the biases by {name}, nT", [size]))
    show("MAGYC and this package", f"gyroscope_rivals.py --runs {runs}", "gyroscope_rivals.csv", rows)


if __name__ == "__main__":
    main()
