"""The numbers of Wu 2025 that were measured, section 4.2: what his own model makes of the set-up of Table 2.

72 poses of a turntable, a field that swings by 8.26 nT, and an intensity of 52185.0 nT that is an average.
"""

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.linalg import norm

from tam_calibration.fit.information import bound
from tam_calibration.fit.lossless import lossless
from tam_calibration.fit.published import count_determined
from tam_calibration.model.residuals import measure_residuals
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, to_degrees, to_nanotesla
from tam_calibration.simulation import Scenario, Simulation, simulate
from tam_calibration.simulation.attitude import RandomAttitudes
from tam_validation.papers import wu2025_coil
from tam_validation.papers.cross import SENSORS
from tam_validation.papers.printed import finding, printed_in, reason_of
from tam_validation.papers.row import DERIVED, PaperNumber, compare, together

_BEFORE_NT = (339.2, 277.2, 283.2, 320.5)
_AFTER_NT = (91.9, 94.4, 98.5, 97.1)
_ORIENTATIONS = 72
_PARAMETERS = 45

TABLE_2: dict[str, list[float]] = printed_in("wu2025")["table_2"]
_KINDS = (
    (("δSx", "δSy", "δSz"), slice(0, 3), "1", 1.0),
    (("B0x", "B0y", "B0z"), slice(6, 9), "nT", to_nanotesla(1.0)),
    (("θ", "φ", "ψ"), slice(3, 6), "°", to_degrees(1.0)),
    (("α", "β", "γ"), slice(9, 12), "°", to_degrees(1.0)),
)
"""Names, columns of ``SensorErrors.to_vector``, unit and its factor from SI."""
_SUFFIX = {"1": "", "nT": " nT", "°": "°"}
_MOUNTINGS = 4000
_ELLIPSOID = 9


def rows(turntable: Scenario) -> list[PaperNumber]:
    """Return the numbers of section 4.2; ours are of the scenario, whose errors are those of Table 2."""
    run = simulate(turntable)
    directions = np.unique(np.round(run.attitude, 9), axis=0)
    determined, _ = count_determined(run.recording, turntable.array)
    return [
        *compare(["Section 4.2, different orientations"], [_ORIENTATIONS], [len(directions)], "1"),
        *compare(["Table 2, parameters that these determine"], [_PARAMETERS], [determined], "1", source=DERIVED),
        *_before_rows(run),
        *_after_rows(run),
        *_parameter_rows(run),
        *wu2025_coil.rows(wu2025_coil.Experiment.of(turntable)),
    ]


def _before_in_any_mounting(run: Simulation) -> tuple[FloatArray, FloatArray]:
    """Return the errors (M, 4) of the raw intensity, RMS and mean absolute, of M random mountings, tesla.

    A mounting is how the array is turned on the table, and the table about the vertical; the paper states neither.
    """
    from scipy.spatial.transform import Rotation

    generator = np.random.default_rng(0)
    headings = Rotation.from_euler("z", generator.uniform(0, 2 * np.pi, (_MOUNTINGS, 1)))
    mountings = Rotation.from_quat(RandomAttitudes().attitudes(np.empty(_MOUNTINGS), generator))
    site = headings.apply(run.scenario.site_field_T)
    turns = mountings.as_matrix()[:, None] @ Rotation.from_quat(run.attitude).inv().as_matrix()
    field = np.einsum("mnij,mj->mni", turns, site).reshape(-1, 3)
    readings = run.errors.distort(field)
    error = (norm(readings, axis=2) - norm(field, axis=1)[:, None]).reshape(_MOUNTINGS, -1, len(SENSORS))
    return np.sqrt(np.mean(error**2, axis=1)), np.abs(error).mean(axis=1)


def _before_rows(run: Simulation) -> list[PaperNumber]:
    none = SensorErrors.none(len(SENSORS))
    ours = measure_residuals(none, run.scenario.array, run.recording, 0.0).sensor_intensity_T
    square, absolute = _before_in_any_mounting(run)
    nearest = np.abs(to_nanotesla(absolute) / _BEFORE_NT - 1).max(axis=1).min()
    told = {"least_nT": to_nanotesla(square[:, 0].min()), "nearest": 100 * nearest}
    names = [f"Section 4.2, e_B before, {sensor}" for sensor in SENSORS]
    return together(finding("wu2025", "before", to_nanotesla(ours), told=told, names=names, paper=_BEFORE_NT))


def _after_rows(run: Simulation) -> list[PaperNumber]:
    average = replace(run.recording, scalar_T=np.full(run.recording.sample_count, norm(run.scenario.site_field_T)))
    published = partial(lossless, as_published=True)
    ours, tracked = (
        to_nanotesla(published(recording, run.scenario.array).in_sample.sensor_intensity_T)
        for recording in (average, run.recording)
    )
    told = {"tracked_nT": tracked.max()}
    names = [f"Section 4.2, e_B after, {sensor}" for sensor in SENSORS]
    return together(finding("wu2025", "after", ours, told=told, names=names, paper=_AFTER_NT))


def _parameter_rows(run: Simulation) -> list[PaperNumber]:
    # Noise that leaves the printed residuals, after the nine parameters of an ellipsoid have taken their part.
    noise = np.array(_AFTER_NT) / to_nanotesla(1.0) / np.sqrt(1 - _ELLIPSOID / _ORIENTATIONS)
    array = run.scenario.array.with_noise(noise, run.scenario.array.scalar_noise_T or 0.0)
    variance = np.diag(bound(run.center_field_T, run.errors, array, has_scalar=True))
    deviation = np.sqrt(variance).reshape(len(SENSORS), 12)
    table = []
    for names, columns, unit, factor in _KINDS:
        free = factor * deviation[:, columns][deviation[:, columns] > 0]
        reason = reason_of("wu2025", "measured", least=free.min(), most=free.max(), unit=_SUFFIX[unit])
        for name in names:
            sensors = SENSORS[-len(TABLE_2[name]) :]
            for sensor, printed in zip(sensors, TABLE_2[name], strict=True):
                table.append(_without_ours(f"Table 2, {name}, {sensor}", printed, unit, reason))
    return table


def _without_ours(name: str, printed: float, unit: str, reason: str) -> PaperNumber:
    return PaperNumber(name, printed, float("nan"), unit, "not reproduced", reason, recorded="not reproduced")
