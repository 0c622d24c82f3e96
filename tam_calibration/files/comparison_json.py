"""A comparison as JSON, with the unit in the key: what a simulator's recording lacks, and the mend."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tam_calibration.comparison.result import (
    AxisNoise,
    Closing,
    Comparison,
    EffectDifference,
    Figure,
    Mend,
    NoiseDifference,
    SourceError,
)
from tam_calibration.comparison.snippets import gazebo_sdf, mujoco_mjcf, python_plugin
from tam_calibration.correction.calibration import Provenance
from tam_calibration.files.mend_yaml import COMPARISON_SCHEMA, mend_to_mapping
from tam_calibration.files.results_json import numbers_of, rounded, source_to_mapping
from tam_calibration.files.text_files import to_json, write_whole
from tam_calibration.model.units import for_people, to_nanotesla


@dataclass(frozen=True)
class Sources:
    """The files that are compared; None where a side is of none, as what nodes collect."""

    simulation: Provenance | None = None
    recording: Provenance | None = None


def write_comparison(path: Path, comparison: Comparison, sources: Sources) -> None:
    """Write a comparison file.

    Parameters
    ----------
    path : Path
        The file.
    comparison : Comparison
        What was compared.
    sources : Sources
        The files that it is of.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    with write_whole(path) as beside:
        beside.write_text(to_json(comparison_to_mapping(comparison, sources)), encoding="utf-8")


def comparison_to_mapping(comparison: Comparison, sources: Sources) -> dict[str, Any]:
    """Return the content of a comparison file; NaN where a value is not known.

    Parameters
    ----------
    comparison : Comparison
        What was compared.
    sources : Sources
        The files that it is of.
    """
    closing, mend = comparison.closing, comparison.mend
    return {
        "schema": COMPARISON_SCHEMA,
        "verdict": comparison.verdict,
        "statement": comparison.statement,
        "remarks": list(comparison.remarks),
        "mistakes": [
            {"kind": mistake.kind, "what": mistake.what, "where": mistake.where, "mend": mistake.mend}
            for mistake in comparison.mistakes
        ],
        "missing_in_simulation": [
            _difference(each) | _shown(by_simulation=each.is_shown_by_other_run, by_recording=True)
            for each in comparison.missing
        ],
        "surplus_in_simulation": [
            _difference(each) | _shown(by_simulation=True, by_recording=each.is_shown_by_other_run)
            for each in comparison.surplus
        ],
        "other_parameters": [
            {
                "effect": each.recording.effect,
                "simulation": _difference(each.simulation),
                "recording": _difference(each.recording),
            }
            for each in comparison.other_parameters
        ],
        "noise": [_noise(each) for each in comparison.noise],
        "gap": None if closing is None else _closing(closing),
        "mend": None if mend is None else mend_in_texts(mend),
        "figures": [_figure(figure) for figure in comparison.figures],
        "simulation": source_to_mapping(sources.simulation),
        "recording": source_to_mapping(sources.recording),
    }


def _difference(difference: EffectDifference) -> dict[str, Any]:
    fitted = difference.fitted
    return {
        "effect": difference.effect,
        "sensors": list(difference.sensors),
        "axes": list(difference.axes),
        **rounded({"probability": difference.probability, "size": difference.size}),
        "parameters": {} if fitted is None else numbers_of(fitted, difference.units),
    }


def _shown(by_simulation: bool, by_recording: bool) -> dict[str, bool]:
    """Say whose run shows an effect, or would if it were there: the side that has it does."""
    return {"shown_by_simulation_run": by_simulation, "shown_by_recording_run": by_recording}


def _noise(difference: NoiseDifference) -> dict[str, Any]:
    simulation, recording = difference.simulation, difference.recording
    return {
        "sensor": recording.sensor or "scalar",
        "axis": recording.axis or None,
        **_level("simulation", simulation),
        **_level("recording", recording),
        "simulation_colour": simulation.colour,
        "colour": recording.colour,
        "differs": difference.differs,
    }


def _level(side: str, noise: AxisNoise) -> dict[str, float]:
    levels = {f"{side}_nT": noise.level_T, f"{side}_standard_error_nT": noise.level_error_T}
    return rounded({name: to_nanotesla(level) for name, level in levels.items()})


def _closing(closing: Closing) -> dict[str, Any]:
    fields = {"before": closing.before_T, "after": closing.after_T}
    gradients = {"before": closing.before_T_per_m, "after": closing.after_T_per_m}
    return {
        **rounded({"before": closing.before, "after": closing.after, "closed": closing.closed}),
        "closed_interval": list(closing.closed_interval),
        **rounded({f"{name}_nT": to_nanotesla(value) for name, value in fields.items()}),
        **rounded({f"{name}_nT_per_m": to_nanotesla(value) for name, value in gradients.items()}),
        **rounded(
            {
                "source_error_before_m": closing.source_error_before_m,
                "source_error_after_m": closing.source_error_after_m,
            }
        ),
        "source_error_simulation": _source_error(closing.simulation_source),
        "source_error_recording": _source_error(closing.recording_source),
        "source_error_mended": _source_error(closing.mended_source),
        "steps": [{"added": step.added, **rounded({"left": step.left})} for step in closing.steps],
        "left": closing.left,
    }


def _source_error(error: SourceError | None) -> dict[str, Any] | None:
    return None if error is None else {"median_m": error.median_m, "interval_m": list(error.interval_m)}


def _figure(figure: Figure) -> dict[str, Any]:
    factor, unit = for_people(figure.unit)
    values = {
        "simulation": figure.simulation,
        "recording": figure.recording,
        "simulation_standard_error": figure.simulation_error,
        "recording_standard_error": figure.recording_error,
    }
    return {
        "group": figure.group,
        "name": figure.name,
        "unit": unit,
        **rounded({name: factor * value for name, value in values.items()}),
        **rounded({"standard_errors": figure.standard_errors}),
        "standing": figure.standing,
    }


def mend_in_texts(mend: Mend) -> dict[str, Any]:
    """Return a mend as texts for simulators (SDF, MJCF, Python), and the content of its parameter file.

    Parameters
    ----------
    mend : Mend
        What to write into the simulator.
    """
    return {
        "sdf": gazebo_sdf(mend),
        "mjcf": mujoco_mjcf(mend),
        "plugin": python_plugin(mend),
        "parameters": mend_to_mapping(mend),
    }
