"""Draw ``docs/images/source.png``: a dipole that a platform passed, in plan and profile.

Run ``python docs/draw_source.py [FOLDER]``. In the folder, where one is named, stay the files of the example:
``pass.csv`` and ``calibration.yaml``, for ``tam locate``.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit import calibrate
from tam_calibration.localization.locate import locate_steady
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.report.survey_report import plot_survey_map
from tam_calibration.results import write_calibration, write_recording
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate
from tam_calibration.sources.dipole import Dipole

TARGET = Path(__file__).parent / "images" / "source.png"
WRECK = Dipole(np.array([30.0, 2.5, -2.3]), np.array([40.0, -60.0, 150.0]))
"""A dipole that is passed at a distance of 3.4 m."""
EARTH_T = np.array([1e-6, 21e-6, -43e-6])
"""Of central Europe, east-north-up."""
VELOCITY_M_PER_S = np.array([1.5, 0.0, 0.0])
"""Of a slow AUV."""
NOISE_T = 1e-9
"""Of each axis of a fluxgate, in one sample."""


def passing(calibration: Calibration, errors: SensorErrors) -> Recording:
    """Return the recording of a platform that passes the wreck, pitching and rolling."""
    time_s = np.arange(800) / 20
    angles = np.stack([0.6 * np.sin(time_s / 3), 0.1 * np.sin(time_s), 0.2 * np.cos(time_s)], axis=1)
    turns = Rotation.from_euler("zyx", angles)
    center = time_s[:, None] * VELOCITY_M_PER_S
    sensors = center[:, None] + np.einsum("nij,kj->nki", turns.as_matrix(), calibration.array.positions_m)
    fields = np.einsum("nji,nkj->nki", turns.as_matrix(), EARTH_T + WRECK.field_T(sensors))
    noise = NOISE_T * np.random.default_rng(30).normal(size=fields.shape)
    return Recording(time_s, errors.distort(fields) + noise, attitude=turns.as_quat())


def main() -> None:
    """Calibrate, pass the wreck, locate it, and draw."""
    run = simulate(read_scenario("tumble_100_hz"))
    calibration = calibrate(run.recording, run.scenario.array)
    recording = passing(calibration, run.scenario.errors)
    if folder := sys.argv[1:]:
        Path(folder[0]).mkdir(exist_ok=True)
        write_recording(Path(folder[0]) / "pass.csv", recording)
        write_calibration(Path(folder[0]) / "calibration.yaml", calibration)
    survey = locate_steady(recording, calibration)
    plot_survey_map(survey).savefig(TARGET, dpi=120)


if __name__ == "__main__":
    main()
