"""Write the table of effects into ``docs/gap.md`` from the effects themselves.

Run ``python docs/list_effects.py`` after an effect was changed; a test holds the two together.
"""

from pathlib import Path

from tam_calibration.effects.effect import Effect, LinearEffect
from tam_calibration.effects.library import installed_effects

PAGE = Path(__file__).parent / "gap.md"
BEGIN, END = "<!-- effects: written by docs/list_effects.py -->\n", "<!-- end of effects -->\n"

_SIZES = """
The largest sizes that the effects have in nature; a fit that asks for more is no finding. Where coefficients have no
size of their own, it is that of all that the effect adds to a reading (root of the mean square over the recording).

| effect | of what | at most | source |
|---|---|---|---|
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
    header = ["| effect | what it is, and its source | channels | what shows it |", "|---|---|---|---|"]
    limits = [line for effect in own for line in _limits(effect)]
    return "\n".join([*header, *rows, *_SIZES.splitlines(), *limits, ""])


def _row(effect: Effect) -> str:
    title = effect.title[:1].upper() + effect.title[1:]
    channels = ", ".join(_CHANNELS[name] for name in effect.channels) or "none"
    return f"| `{effect.name}` | {title}. {effect.physics} | {channels} | {effect.excitation} |"


def _limits(effect: Effect) -> list[str]:
    limits = dict(effect.limits)
    if isinstance(effect, LinearEffect) and effect.largest_signal is not None:
        limits["part of the field" if effect.largest_signal.unit == "1" else "size"] = effect.largest_signal
    return [
        f"| `{effect.name}` | {name} | {limit.with_unit(limit.largest)} | {limit.source} |"
        for name, limit in limits.items()
    ]


def with_table(page: str) -> str:
    """Return the text of the page with the table in its place."""
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}{effects_table()}{END}{after}"


if __name__ == "__main__":
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
