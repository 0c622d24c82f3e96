"""The mend file: what a simulator lacks, for ``tam simulate --from-comparison`` and for a simulator's plugin."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from tam_calibration import __version__
from tam_calibration.comparison.result import Mend, NoiseTerm
from tam_calibration.effects.library import check_numbers, effect_named, units_of
from tam_calibration.files.calibration_schema import calibration_of
from tam_calibration.files.calibration_yaml import calibration_to_mapping
from tam_calibration.files.effects_schema import EffectFile, effect_to_mapping
from tam_calibration.files.quantities import Hertz, NanoteslaSize
from tam_calibration.files.schema import Bounds, check
from tam_calibration.files.text_files import in_file, nanotesla_to_write, read_text, write_whole
from tam_calibration.files.yaml_document import dump_mapping, parse_mapping
from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.model.units import from_nanotesla

SCHEMA = "tam_calibration/mend/1"
COMPARISON_SCHEMA = "tam_calibration/compare/1"

_MAY_BE_MISSING = frozenset({"covariance_SI", "held_out", "name", "size_bytes", "sha256"})
"""Keys of a calibration under which null is none; elsewhere it is what JSON has instead of NaN."""


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
    path = Path(path)
    text = read_text(path)
    with in_file(path):
        content = parse_mapping(text)
        return mend_of(_of_comparison(content) if content.get("schema") == COMPARISON_SCHEMA else content)


def write_mend(path: str | Path, mend: Mend) -> None:
    """Write a mend file.

    Parameters
    ----------
    path : str or Path
        The YAML file; one that is there is replaced once the new one is whole.
    mend : Mend
        What it shall hold; fields are written in nT.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    with write_whole(Path(path)) as beside:
        beside.write_text(dump_mapping(mend_to_mapping(mend)), encoding="utf-8")


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
    mapping = place | {"white_nT": _nanotesla(term.white_T), "added_white_nT": _nanotesla(term.added_white_T)}
    if np.isfinite(term.knee_hz):
        mapping |= {"knee_hz": float(term.knee_hz), "exponent": float(term.exponent)}
    if term.band_hz is not None:
        mapping |= {"band_hz": [float(limit) for limit in term.band_hz], "band_nT": _nanotesla(term.band_T)}
    return mapping


def _nanotesla(tesla: float) -> float:
    return float(nanotesla_to_write(np.array(tesla)))


@dataclass(frozen=True, kw_only=True)
class _Noise:
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
        return NoiseTerm(
            0 if self.sensor == "scalar" else self.sensor,
            self.axis or "",
            from_nanotesla(self.white_nT),
            from_nanotesla(self.added_white_nT),
            float("nan") if self.knee_hz is None else self.knee_hz,
            float("nan") if self.exponent is None else self.exponent,
            self.band_hz,
            from_nanotesla(self.band_nT),
        )


@dataclass(frozen=True, kw_only=True)
class _Mend:
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
    schema = content.get("schema")
    if schema != SCHEMA:
        stated = "has no schema" if schema is None else f"has the schema {quoted(schema)}"
        raise InputError(f"this is no mend that this version reads: it {stated}, not {SCHEMA!r}")
    stored = check(content, _Mend)
    with in_file("calibration"):
        calibration = calibration_of(stored.calibration)
    added = tuple(effect.to_fitted() for effect in stored.added)
    for fitted in added:
        check_numbers(fitted, calibration.errors, calibration.array)
    for name in stored.removed:
        effect_named(name)
    noise = tuple(term.to_term() for term in stored.noise)
    count = calibration.array.sensor_count
    if any(term.sensor > count for term in noise):
        raise InputError(f"noise is stated of a sensor beyond the {count} that there are")
    return Mend(added, tuple(stored.removed), noise, calibration, stored.rate_hz)


def _of_comparison(content: dict[str, Any]) -> dict[str, Any]:
    """Return the content of a mend file that the JSON of a comparison holds."""
    mend = content.get("mend")
    parameters = mend.get("parameters") if isinstance(mend, dict) else None
    if not isinstance(parameters, dict):
        raise InputError(
            "this comparison has no mend: nothing was compared, as where the simulator has a gross mistake"
        )
    return parameters | {"calibration": _with_nan(parameters.get("calibration"))}


def _with_nan(content: Any, key: str = "") -> Any:
    """Return a content with NaN where JSON has null instead."""
    if isinstance(content, dict):
        return {name: _with_nan(value, name) for name, value in content.items()}
    if isinstance(content, list):
        return [_with_nan(value) for value in content]
    return float("nan") if content is None and key not in _MAY_BE_MISSING else content
