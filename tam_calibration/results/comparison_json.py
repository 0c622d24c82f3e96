"""A comparison as JSON, with the unit in the key: what a simulator's recording lacks, and the mend.

The mend file contains what a simulator lacks, for ``tam simulate --from-comparison`` and for a simulator's plugin.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from tam_calibration import __version__
from tam_calibration.comparison import result
from tam_calibration.comparison.mend import Mend, NoiseTerm, gazebo_sdf, python_plugin
from tam_calibration.comparison.side import Figure
from tam_calibration.correction.parts import Provenance
from tam_calibration.effects.library import effect_named, units_of
from tam_calibration.files.schema import Bounds, Document, Hertz, NanoteslaSize, check_file, in_si, value_to_write
from tam_calibration.files.text_files import in_file, write_text
from tam_calibration.files.yaml_document import dump_mapping, mapping_in
from tam_calibration.gap.noise import AxisNoise
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import for_people, to_nanotesla
from tam_calibration.results import results_json
from tam_calibration.results.calibration_schema import calibration_of
from tam_calibration.results.calibration_yaml import calibration_to_mapping
from tam_calibration.results.effects_schema import EffectFile, effect_to_mapping

SCHEMA = "tam_calibration/mend/1"
COMPARISON_SCHEMA = "tam_calibration/compare/1"


def read_mend(path: str | Path) -> Mend:
    """Read a mend: from its own file, or from the JSON of a comparison.

    Parameters
    ----------
    path : str or Path
        The YAML file, or the JSON that `tam compare` wrote.

    Returns
    -------
    Mend
        In SI; its numbers are those that were written.

    Raises
    ------
    InputError
        When it cannot be read, is of another version, is damaged, or is of a comparison without a mend.
    """
    with mapping_in(Path(path)) as content:
        return mend_of(_of_comparison(content) if content.get("schema") == COMPARISON_SCHEMA else content)


def write_mend(path: str | Path, mend: Mend) -> None:
    """Write a mend file.

    Parameters
    ----------
    path : str or Path
        The YAML file; one that is there is replaced once the new one is complete.
    mend : Mend
        What it shall hold; fields are written in nT.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    write_text(Path(path), dump_mapping(mend_to_mapping(mend)))


def mend_to_mapping(mend: Mend) -> dict[str, Any]:
    """Return the content of a mend file, which is that of ``mend``, ``parameters`` in the JSON of a comparison too."""
    calibration = mend.calibration
    return {
        "schema": SCHEMA,
        "software": f"tam_calibration {__version__}",
        "rate_hz": float(mend.rate_hz),
        "added": [
            effect_to_mapping(fitted, units_of(fitted, calibration.errors, calibration.array)) for fitted in mend.added
        ],
        "removed": list(mend.removed),
        "noise": [_noise_to_mapping(term) for term in mend.noise],
        "calibration": calibration_to_mapping(calibration),
    }


def _noise_to_mapping(term: NoiseTerm) -> dict[str, Any]:
    place = {"sensor": "scalar"} if term.sensor == 0 else {"sensor": term.sensor, "axis": term.axis}
    mapping = place | {"white_nT": term.white_T, "added_white_nT": term.added_white_T}
    if np.isfinite(term.knee_hz):
        mapping |= {"knee_hz": float(term.knee_hz), "exponent": float(term.exponent)}
    if term.band_hz is not None:
        mapping |= {"band_hz": [float(limit) for limit in term.band_hz], "band_nT": term.band_T}
    return {key: value_to_write(key, value) for key, value in mapping.items()}


class _Noise(Document):
    sensor: Annotated[int, Bounds(least=1)] | Literal["scalar"]
    axis: Literal["x", "y", "z"] | None = None
    white_nT: NanoteslaSize
    added_white_nT: NanoteslaSize
    knee_hz: Hertz | None = None
    exponent: Annotated[float, Bounds(above=0, most=10)] | None = None
    band_hz: tuple[Hertz, Hertz] | None = None
    band_nT: NanoteslaSize = 0.0

    def to_term(self) -> NoiseTerm:
        """Return it in SI."""
        is_scalar = self.sensor == "scalar"
        if is_scalar != (self.axis is None):
            raise InputError("noise of a sensor is stated with its axis, and that of the scalar without one")
        if (self.knee_hz is None) != (self.exponent is None):
            raise InputError("slow noise is stated by both knee_hz and exponent")
        if self.band_hz is not None and not self.band_hz[0] < self.band_hz[1]:
            raise InputError(f"band_hz must be a lower and a higher frequency, not {list(self.band_hz)}")
        _, _, white_T, added_white_T, *_, band_T = in_si(self)
        knee_hz, exponent = (float("nan") if each is None else each for each in (self.knee_hz, self.exponent))
        sensor = 0 if self.sensor == "scalar" else self.sensor
        return NoiseTerm(sensor, self.axis or "", white_T, added_white_T, knee_hz, exponent, self.band_hz, band_T)


class _Mend(Document):
    schema: Literal["tam_calibration/mend/1"]
    software: str
    rate_hz: Hertz
    added: list[EffectFile]
    removed: list[str]
    noise: list[_Noise]
    calibration: dict[str, Any]


def mend_of(content: dict[str, Any]) -> Mend:
    """Return the mend of the keys and values of a mend file.

    Raises
    ------
    InputError
        When they are of another version, incomplete, or contradict each other.
    """
    stored = check_file(content, "mend", SCHEMA, _Mend)
    with in_file("calibration"):
        calibration = calibration_of(stored.calibration)
    added = tuple(effect.to_fitted(calibration.errors, calibration.array) for effect in stored.added)
    for name in stored.removed:
        effect_named(name)
    noise = tuple(term.to_term() for term in stored.noise)
    count = calibration.array.sensor_count
    if any(term.sensor > count for term in noise):
        raise InputError(f"noise is stated of a sensor beyond the {count} that there are")
    return Mend(added, tuple(stored.removed), noise, calibration, stored.rate_hz)


def _of_comparison(content: dict[str, Any]) -> dict[str, Any]:
    """Return the content of a mend file that the JSON of a comparison contains."""
    mend = content.get("mend")
    parameters = mend.get("parameters") if isinstance(mend, dict) else None
    if not isinstance(parameters, dict):
        raise InputError(
            "this comparison has no mend: nothing was compared, as where the simulator has a gross mistake"
        )
    return parameters


def comparison_to_mapping(
    comparison: result.Comparison, simulation: Provenance | None = None, recording: Provenance | None = None
) -> dict[str, Any]:
    """Return the content of a comparison file; NaN where a value is not known.

    Parameters
    ----------
    comparison : Comparison
        What was compared.
    simulation, recording : Provenance, optional
        The files that it is of.
    """
    closing, mend = comparison.closing, comparison.mend
    return {
        "schema": COMPARISON_SCHEMA,
        **results_json.attributes(comparison, "verdict", "statement"),
        "laws": {
            name: [results_json.law_to_mapping(law) for law in laws] for name, laws in comparison.laws_of_one.items()
        },
        "remarks": list(comparison.remarks),
        "mistakes": [results_json.attributes(each, "kind", "what", "where", "mend") for each in comparison.mistakes],
        "missing_in_simulation": [_shown(each, "simulation", "recording") for each in comparison.missing],
        "surplus_in_simulation": [_shown(each, "recording", "simulation") for each in comparison.surplus],
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
        "simulation": results_json.source_to_mapping(simulation),
        "recording": results_json.source_to_mapping(recording),
    }


def _difference(difference: result.EffectDifference) -> dict[str, Any]:
    fitted = difference.fitted
    return {
        **results_json.rounded(results_json.attributes(difference, "effect", "sensors", "axes", "probability", "size")),
        "parameters": {} if fitted is None else results_json.numbers_of(fitted, difference.units),
    }


def _shown(difference: result.EffectDifference, lacking: str, having: str) -> dict[str, Any]:
    """Return an effect and whose run shows it, or would if it were there: that of the side that has it does."""
    shows = {lacking: difference.is_shown_by_other_run, having: True}
    sides = ("simulation", "recording")
    return _difference(difference) | {f"shown_by_{side}_run": shows[side] for side in sides}


def _noise(difference: result.NoiseDifference) -> dict[str, Any]:
    simulation, recording = difference.simulation, difference.recording
    return {
        **results_json.place_of(recording),
        **_level("simulation", simulation),
        **_level("recording", recording),
        "simulation_colour": simulation.colour,
        "colour": recording.colour,
        "differs": difference.differs,
    }


def _level(side: str, noise: AxisNoise) -> dict[str, float]:
    levels = {f"{side}_nT": noise.level_T, f"{side}_standard_error_nT": noise.level_error_T}
    return results_json.rounded({name: to_nanotesla(level) for name, level in levels.items()})


def _closing(closing: result.Closing) -> dict[str, Any]:
    sides = ("simulation", "recording", "mended")
    return {
        **results_json.sizes(closing),
        **results_json.rounded(results_json.attributes(closing, "source_error_before_m", "source_error_after_m")),
        **{f"source_error_{each}": _source_error(getattr(closing, f"{each}_source")) for each in sides},
        "steps": [results_json.rounded(results_json.attributes(step, "added", "left")) for step in closing.steps],
        "left": closing.left,
    }


def _source_error(error: result.SourceError | None) -> dict[str, Any] | None:
    return None if error is None else results_json.attributes(error, "median_m", "interval_m")


def _figure(figure: Figure) -> dict[str, Any]:
    sides = {"simulation": figure.simulation, "recording": figure.recording}
    factor, unit = for_people(figure.recording.unit)
    values = {name: factor * side.value for name, side in sides.items()}
    errors = {f"{name}_standard_error": factor * side.standard_error for name, side in sides.items()}
    return {
        **results_json.attributes(figure.recording, "group", "name"),
        "unit": unit,
        **results_json.rounded(values | errors),
        **results_json.rounded(results_json.attributes(figure, "standard_errors", "standing")),
    }


def mend_in_texts(mend: Mend) -> dict[str, Any]:
    """Return a mend as texts for simulators (SDF, Python), and the content of its parameter file.

    Parameters
    ----------
    mend : Mend
        What to write into the simulator.
    """
    return {"sdf": gazebo_sdf(mend), "plugin": python_plugin(mend), "parameters": mend_to_mapping(mend)}
