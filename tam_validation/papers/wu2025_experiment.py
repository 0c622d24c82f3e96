"""The numbers of Wu 2025 that were measured, section 4.2: what his own model makes of the set-up of Table 2.

72 poses of a turntable, a field that swings by 8.26 nT, and an intensity of 52185.0 nT that is an average.
"""

import numpy as np
from numpy.linalg import norm
from scipy.spatial.transform import Rotation

from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray, from_nanotesla, to_nanotesla
from tam_calibration.results.scenario import read_scenario
from tam_validation.papers.cross import SetUp
from tam_validation.papers.li2018b import count_determined
from tam_validation.papers.row import Draws
from tam_validation.papers.wu2025_coil import Experiment, Plate, directions
from tam_validation.papers.wu2025_sweeps import DRIFT_NT, published_errors

_SWINGS = 1.44
"""Of the field during the 72 poses of 20 s: a period of 1000 s."""
_MOUNTING = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
"""From the array to the table: of 24 that put the axes along the table's, two give the errors before calibration."""


def turntable(seed: int) -> tuple[SetUp, FloatArray]:
    """Return the readings of the turntable and its rotations (72, 3, 3) from the array to the world.

    How the table is turned about the vertical is not printed, and drawn. The scalar is the average that the paper
    states; the field follows its drift.

    Parameters
    ----------
    seed : int
        Of the heading, the noise and the drift's phase.
    """
    scenario = read_scenario("wu_turntable")
    generator = np.random.default_rng(seed)
    poses = Rotation.from_quat(scenario.motion.attitudes(np.arange(float(scenario.sample_count)), generator))
    heading = Rotation.from_euler("z", generator.uniform(0, 2 * np.pi))
    to_world = heading * poses * Rotation.from_matrix(_MOUNTING)
    phase = 2 * np.pi * (_SWINGS * np.arange(len(poses)) / len(poses) + generator.random())
    swing = np.sqrt(2) * from_nanotesla(DRIFT_NT) * np.sin(phase)
    site = scenario.site_field_T
    field = to_world.inv().apply(site) * (1 + swing / norm(site))[:, None]
    noise = scenario.array.with_stated_noise().vector_noise_T
    readings = scenario.errors.distort(field) + noise[:, None] * generator.normal(size=(len(poses), 4, 3))
    time_s = np.arange(len(poses)) / scenario.rate_hz
    recording = Recording(time_s, readings, np.full(len(poses), norm(site)), attitude=to_world.as_quat())
    return SetUp(scenario.array, 0.21, scenario.errors, field, recording), to_world.as_matrix()


def mean_absolute_nT(fields_T: FloatArray, intensity_T: FloatArray | float) -> FloatArray:
    """Return the means (4,) of the absolute errors of the intensity that Fig. 11 shows, nT."""
    return to_nanotesla(np.abs(norm(fields_T, axis=2) - np.reshape(intensity_T, (-1, 1))).mean(axis=0))


def simulate(seed: int) -> Draws:
    """Return the numbers of section 4.2 by the findings of the paper."""
    case, to_world = turntable(seed)
    raw, stated = case.recording.readings_T, case.recording.scalar_T
    assert stated is not None
    found = published_errors(case.recording, as_published=True)
    coil = Experiment.of(case, found)
    generator = np.random.default_rng([seed, 1])
    axis, plate = directions(1, generator), Plate.drawn(generator)
    error = "Section 4.2, mean absolute error of the intensity"
    position = "Section 4.2, RMSE of the coil's position"
    return {
        "Section 4.2, different orientations": np.array([len(np.unique(np.round(to_world, 9), axis=0))]),
        "Section 4.2, parameters that these determine": np.array([count_determined(case.recording, case.array)[0]]),
        f"{error} before": mean_absolute_nT(raw, stated),
        f"{error} after": mean_absolute_nT(found.restore(raw), stated),
        **{f"{position} {stage}": coil.rmse_m(stage, axis) for stage in coil.estimates},
        **{f"{position} {stage}, over a metal table": coil.rmse_m(stage, axis, plate) for stage in coil.estimates},
    }
