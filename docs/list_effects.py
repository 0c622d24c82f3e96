"""Write the table of effects into ``docs/gap.md`` from the effects themselves.

Run ``python docs/list_effects.py`` after an effect was changed; a test holds the two together.
"""

from pathlib import Path

from tam_calibration.effects.effect import Effect
from tam_calibration.effects.library import installed_effects

PAGE = Path(__file__).parent / "gap.md"
BEGIN, END = "<!-- effects: written by docs/list_effects.py -->\n", "<!-- end of effects -->\n"

_CHANNELS = {
    "scalar_T": "scalar",
    "temperature_C": "temperature",
    "current_A": "current",
    "attitude": "attitude",
}


def effects_table() -> str:
    """Return the table of this package's effects in Markdown."""
    own = [effect for effect in installed_effects().values() if type(effect).__module__.startswith("tam_calibration.")]
    rows = [_row(effect) for effect in own]
    return "\n".join(
        ["| effect | what it is, and its source | channels | what shows it |", "|---|---|---|---|", *rows, ""]
    )


def _row(effect: Effect) -> str:
    title = effect.title[:1].upper() + effect.title[1:]
    channels = ", ".join(_CHANNELS[name] for name in effect.channels) or "none"
    return f"| `{effect.name}` | {title}. {effect.physics} | {channels} | {effect.excitation} |"


def with_table(page: str) -> str:
    """Return the text of the page with the table in its place."""
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}{effects_table()}{END}{after}"


if __name__ == "__main__":
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
