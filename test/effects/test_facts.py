"""What the engine needs to know of an effect stands in its class or in ``causes.toml``, and nowhere else."""

import re
import tomllib
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import pytest

from tam_calibration.effects.effect import LinearEffect
from tam_calibration.effects.library import installed_effects
from tam_calibration.gap.steps import _is_nested

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "tam_calibration"
NAMES = frozenset(tomllib.loads((PACKAGE / "effects" / "causes.toml").read_text()))


def test_no_module_names_an_effect_of_the_library():
    """But the effects themselves: no other holds the name of one as a string."""
    assert len(NAMES) > 20
    string = re.compile(rf"""["'](?:{"|".join(NAMES)})["']""")
    modules = [path for path in PACKAGE.rglob("*.py") if path.parent.name != "effects"]
    holding = {str(path.relative_to(PACKAGE)): string.findall(path.read_text()) for path in modules}
    assert {path: names for path, names in holding.items() if names} == {}


@dataclass(frozen=True)
class MadeUp(LinearEffect):
    """An effect of which only what its class says is known."""

    name: str
    limit_of: tuple[str, ...] = ()
    nearly_within: tuple[str, ...] = ()

    def terms(self, covariates, shape):
        """Return nothing."""
        return ()


@pytest.fixture
def special():
    """Return an effect that is a special case of another."""
    return MadeUp("special", limit_of=("whole",))


@pytest.fixture
def whole():
    """Return an effect that holds another."""
    return MadeUp("whole")


@pytest.mark.parametrize("fact", ["limit_of", "nearly_within"])
def test_support_treats_them_as_nested(whole, fact):
    """In either order; an effect is not within itself."""
    special = MadeUp("special", **{fact: ("whole",)})
    assert _is_nested(special, whole)
    assert _is_nested(whole, special)
    assert not _is_nested(whole, whole)


def test_every_name_that_a_class_states_is_an_effect():
    """Of the library, or of another package that is installed."""
    effects = installed_effects()
    for effect in effects.values():
        named = [getattr(effect, fact, ()) for fact in ("limit_of", "nearly_within")]
        assert set(chain.from_iterable(named)) <= effects.keys()
