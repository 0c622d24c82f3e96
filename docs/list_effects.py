"""Write the tables of ``docs/reference/effects.md`` from the effects themselves.

Run ``python docs/list_effects.py`` after an effect was changed; a test compares the two.
"""

import re
from pathlib import Path

import numpy as np

from tam_calibration.effects.effect import Effect, Limit, LinearEffect
from tam_calibration.effects.library import installed_effects
from tam_calibration.model.units import to_nanotesla

PAGE = Path(__file__).parent / "reference" / "effects.md"
BEGIN, END = "<!-- effects: written by docs/list_effects.py -->\n", "<!-- end of effects -->\n"

_SIZES = """
## Largest sizes in nature

A fit that asks for more is no finding. `sizes` in the JSON of `tam diagnose` has the source of each limit. If a
coefficient has no limit, the limit is for everything that the effect adds to a reading (root mean square over the
recording).

| effect | largest size |
|---|---|
"""

_CHANNELS = {
    "scalar_T": "scalar",
    "temperature_C": "temperature",
    "current_A": "current",
    "attitude": "attitude",
}


def effects_table() -> str:
    """Return the tables of this package's effects, and of their largest sizes, in Markdown."""
    own = [effect for effect in installed_effects().values() if type(effect).__module__.startswith("tam_calibration.")]
    rows = [_row(effect) for effect in own]
    header = ["| effect | what it is | source | channel | motion that shows it |", "|---|---|---|---|---|"]
    limits = [_limits(effect) for effect in own if effect.limits or _signal(effect)]
    return "\n".join([*header, *rows, *_SIZES.splitlines(), *limits, ""])


def _row(effect: Effect) -> str:
    title = effect.title[:1].upper() + effect.title[1:]
    channels = ", ".join(_CHANNELS[name] for name in effect.channels) or "none"
    texts = "; ".join(re.findall(r"\(([^()]*)\)", effect.physics)).split("; ")
    sources = dict.fromkeys(map(_short, texts))
    return f"| `{effect.name}` | {title} | {'; '.join(filter(None, sources))} | {channels} | {effect.excitation} |"


def _short(source: str) -> str:
    """Return authors and year of a source, or nothing if there is no year."""
    if "," not in source:
        return source.strip() if re.search(r"\d{4}", source) else ""
    years = re.findall(r"\b(?:18|19|20)\d\d\b", source)
    authors = re.split(r",| (?=\d{4}\b)", source)[0].rpartition(": ")[2].strip()
    return f"{authors} {years[-1]}" if years else ""


def _limits(effect: Effect) -> str:
    limits = dict(effect.limits)
    if signal := _signal(effect):
        limits["part of the field" if signal.unit == "1" else "size"] = signal
    sizes = ". ".join(f"{name} {with_unit(limit.largest, limit.unit)}" for name, limit in limits.items())
    return f"| `{effect.name}` | {sizes} |"


def with_unit(value: float, unit: str) -> str:
    """Return a value in an SI unit as people read it: teslas as nanoteslas."""
    is_field = unit.startswith("T")
    number = np.format_float_positional(to_nanotesla(value) if is_field else value, 3, fractional=False, trim="-")
    return number if unit == "1" else f"{number} {'n' * is_field}{unit}"


def _signal(effect: Effect) -> Limit | None:
    return effect.largest_signal if isinstance(effect, LinearEffect) else None


def with_table(page: str) -> str:
    """Return the text of the page with the table in its place."""
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}{effects_table()}{END}{after}"


if __name__ == "__main__":
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
