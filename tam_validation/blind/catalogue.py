"""All kinds of causes by their names: the library's effects, made by other physics than the library's, and others."""

import tomllib
from pathlib import Path
from typing import Any

from tam_validation.blind import SETS, disorder, instrument_faults, material, surroundings, vehicle
from tam_validation.blind.disturbance import Entry
from tam_validation.blind.outside import OUTSIDE
from tam_validation.blind.outside_fifteenth import FIFTEENTH
from tam_validation.blind.outside_fourteenth import FOURTEENTH
from tam_validation.blind.outside_sixteenth import SIXTEENTH

_DRAWS = {
    name: draw
    for module in (disorder, instrument_faults, material, surroundings, vehicle)
    for name, draw in vars(module).items()
}


def _entry(name: str, told: dict[str, Any]) -> Entry:
    fields: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in told.items()}
    return Entry(_DRAWS[name], **fields)


_TABLE = Path(__file__).with_name("catalogue.toml").read_text(encoding="utf-8")

CATALOGUE = {name: _entry(name, told) for name, told in tomllib.loads(_TABLE).items()}
"""The effects of the library. ``most_nT`` has a reason each: 0.3 %/°C of a magnetoresistor's gain over 30 °C; a few
per cent of the field in a core's loops, its transfer function and a plate's currents; a heading error of the
pumped scalars without compensation; an hour of a magnetic storm; a magnet at a sensor; arms that bend by three degrees;
spikes of twice the field; the steps of a phone's converter; elsewhere a fifth of the field, past which nobody
calibrates."""

OUTSIDE_SETS = dict(zip(SETS, (OUTSIDE, FOURTEENTH, FIFTEENTH, SIXTEENTH), strict=True))
"""The causes outside the library, set by set."""

CAUSES = CATALOGUE | OUTSIDE | FOURTEENTH | FIFTEENTH | SIXTEENTH
"""Every cause that a case may hold."""

LAWS: dict[str, dict[str, list[str]]] = tomllib.loads(Path(__file__).with_name("laws.toml").read_text(encoding="utf-8"))
"""Of each cause the laws and the courses that are a right answer, the usual ones first: what it does to a reading, and
how its size goes with time. More than one where the same data bear out either."""

CHANNELS = ("temperature", "current", "attitude")
