"""Draw ``docs/images/tumble.png``: the tensor of a tumbling array before and after calibration.

Run ``python docs/draw_tumble.py``.
"""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from tam_calibration.fit import calibrate
from tam_calibration.model.array import OUTPUT_NAMES, TENSOR_OUTPUTS
from tam_calibration.model.sensor_errors import SensorErrors, residual_series
from tam_calibration.model.units import to_nanotesla
from tam_calibration.report.page import FLOOR_COLOR, STYLE
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate

TARGET = Path(__file__).parent / "images" / "tumble.png"


@matplotlib.rc_context(STYLE)
def main() -> None:
    """Simulate, calibrate and draw."""
    run = simulate(read_scenario("tumble_100_hz"))
    recording, array = run.recording, run.scenario.array
    calibration = calibrate(recording, array)
    figure = Figure(figsize=(9, 3), layout="constrained")
    both = zip(figure.subplots(1, 2), (SensorErrors.none(4), calibration.errors), strict=True)
    for axes, errors in both:
        tensor = to_nanotesla(residual_series(errors, array, recording, calibration.intensity_T).tensor_T_per_m)
        for component, output in enumerate(TENSOR_OUTPUTS):
            axes.plot(recording.time_s, tensor[:, component], linewidth=0.6, label=OUTPUT_NAMES[output])
        rmse = np.sqrt(np.mean(np.sum(tensor**2, axis=1)))
        axes.set_title(f"{'raw' if rmse > 100 else 'calibrated'}: $e_T$ = {rmse:.4g} nT/m", loc="left")
        axes.set_xlabel("time (s)")
    floor = to_nanotesla(calibration.floor.tensor_rmse_T_per_m)
    axes.axhline(floor, color=FLOOR_COLOR, linestyle="dashed", linewidth=0.8)
    axes.axhline(-floor, color=FLOOR_COLOR, linestyle="dashed", linewidth=0.8, label=f"noise floor {floor:.3g}")
    axes.set_ylim(-4 * floor, 4 * floor)
    axes.legend(loc="upper right", ncols=3, frameon=False, fontsize=7)
    figure.supylabel("gradient tensor in a uniform field (nT/m)")
    TARGET.parent.mkdir(exist_ok=True)
    figure.savefig(TARGET, dpi=120)


if __name__ == "__main__":
    main()
