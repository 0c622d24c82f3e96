"""Draw ``docs/images/gap.png``: where the gap lies of an array one of whose sensors drifts with temperature.

Run ``python docs/draw_gap.py``.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from tam_calibration.gap import diagnose
from tam_calibration.model.units import from_nanotesla
from tam_calibration.report.gap_plots import GapView, plot_map
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import ScalarReference, Temperature

TARGET = Path(__file__).parent / "images" / "gap.png"
DRIFT_NT_PER_K = np.array([0.6, -0.2, 0.4])
"""A few times what a good fluxgate has, so that it is seen in a picture."""


def main() -> None:
    """Simulate, disturb sensor 2, diagnose and draw."""
    scenario = read_scenario("tumble_100_hz")
    run = simulate(replace(scenario, scalar=ScalarReference(), temperature=Temperature(15.0, 25.0, 0.05)))
    recording = run.recording
    assert recording.temperature_C is not None
    readings = recording.readings_T.copy()
    readings[:, 1] += from_nanotesla(DRIFT_NT_PER_K) * (recording.temperature_C - 20)[:, None]
    gap = diagnose(replace(recording, readings_T=readings), run.scenario.array)
    print(gap.statement)
    plot_map(GapView(gap)).savefig(TARGET, dpi=130)


if __name__ == "__main__":
    main()
