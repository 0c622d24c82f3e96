"""Scenario files, shipped ones by name, and the truth that is written beside a simulated recording."""

from pathlib import Path
from typing import Any

import numpy as np

from tam_calibration.files.calibration_yaml import orientation_to_mapping
from tam_calibration.files.configuration import configuration_folder
from tam_calibration.files.effects_schema import effect_to_mapping
from tam_calibration.files.scenario_schema import scenario_of
from tam_calibration.files.text_files import degrees_to_write, nanotesla_to_write, write_whole
from tam_calibration.files.yaml_document import dump_mapping, mapping_in
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import to_nanotesla
from tam_calibration.simulation import Scenario, Simulation

_TRUTH_SCHEMA = "tam_calibration/truth/1"


def shipped_scenarios() -> dict[str, Path]:
    """Return the paths of the scenarios that come with the package, by name."""
    return {path.stem: path for path in sorted((configuration_folder() / "scenarios").glob("*.yaml"))}


def _path_of(name_or_path: str | Path) -> Path:
    shipped = shipped_scenarios()
    path = shipped.get(str(name_or_path), Path(name_or_path))
    if not path.exists():
        raise InputError(
            f"there is no file {path}, and no scenario of that name comes with it: {', '.join(shipped)} do"
        )
    return path


def files_of_scenario(name_or_path: str | Path) -> list[Path]:
    """Return the files that a scenario is read from: its own, and the observatory's that it may name.

    Parameters
    ----------
    name_or_path : str or Path
        As of `read_scenario`.

    Raises
    ------
    InputError
        When there is none, or it is no YAML.
    """
    path = _path_of(name_or_path)
    with mapping_in(path) as content:
        drift = content.get("drift")
    named = drift.get("file") if isinstance(drift, dict) else None
    return [path, path.parent / named] if isinstance(named, str) else [path]


def read_scenario(name_or_path: str | Path) -> Scenario:
    """Read a scenario file, or a shipped scenario by its name.

    Parameters
    ----------
    name_or_path : str or Path
        auv, tumble_100_hz, warming_up, wu_table_1 or wu_turntable, or a YAML file.

    Returns
    -------
    Scenario
        In SI.

    Raises
    ------
    InputError
        When there is none, a key is not known or missing, or the values make no scenario.

    Examples
    --------
    >>> from tam_calibration import read_scenario
    >>> scenario = read_scenario("wu_table_1")  # Wu 2025, Table 1
    >>> scenario.sample_count, scenario.array.sensor_count, scenario.effects
    (360, 4, ())
    """
    path = _path_of(name_or_path)
    with mapping_in(path) as content:
        return scenario_of(content, path.parent)


def write_truth(path: Path, simulation: Simulation) -> None:
    """Write what was simulated: the sensors' true errors and effects as a calibration file states them, and the field.

    Parameters
    ----------
    path : Path
        The YAML file; one that is there is replaced once the new one is whole.
    simulation : Simulation
        Errors are written in nT and degrees, of the field the mean and standard deviation of its intensity at the
        centre.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    intensity = np.linalg.norm(simulation.center_field_T, axis=1)
    content = {
        "schema": _TRUTH_SCHEMA,
        "sensors": _sensors_to_mapping(simulation.errors),
        "field": {
            "intensity_nT": round(float(to_nanotesla(intensity.mean())), 6),
            "intensity_standard_deviation_nT": round(float(to_nanotesla(intensity.std())), 6),
        },
        "seed": simulation.scenario.seed,
    }
    if simulation.scenario.effects:
        content["effects"] = [effect_to_mapping(effect) for effect in simulation.scenario.effects]
    with write_whole(path) as beside:
        beside.write_text(dump_mapping(content), encoding="utf-8")


def _sensors_to_mapping(errors: SensorErrors) -> list[dict[str, Any]]:
    """Return the errors in the units of files, one block for each sensor."""
    columns = {
        "scale_factor": errors.scale_factor,
        "non_orthogonality_deg": degrees_to_write(errors.non_orthogonality),
        "bias_nT": nanotesla_to_write(errors.bias_T),
        "misalignment_deg": degrees_to_write(errors.misalignment),
        "matrix": errors.matrix,
    }
    return [
        {"sensor": index + 1}
        | {name: values[index].tolist() for name, values in columns.items()}
        | orientation_to_mapping(errors, index)
        for index in range(errors.sensor_count)
    ]
