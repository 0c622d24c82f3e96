"""What the pages say of the effects is true: the table, and the example of an effect of one's own."""

import re
import runpy
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import numpy as np
import pytest

from tam_calibration.effects import library
from tam_calibration.gap import diagnose
from tam_calibration.model.recording import Recording

DOCS = Path(__file__).parents[2] / "docs"


def test_the_table_is_that_of_the_effects():
    """After a change of an effect, run ``python docs/list_effects.py``."""
    page = (DOCS / "reference" / "effects.md").read_text(encoding="utf-8")
    names = runpy.run_path(str(DOCS / "list_effects.py"))
    assert names["with_table"](page) == page
    assert page.count("\n| `") >= 16


@pytest.fixture
def with_example(monkeypatch, tmp_path):
    """Install the page's example as a package of somebody else's would."""
    page = (DOCS / "how_to" / "add_effect.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    (tmp_path / "my_package").mkdir()
    (tmp_path / "my_package" / "__init__.py").touch()
    (tmp_path / "my_package" / "effects.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    (value,) = re.findall(r'^rectified_current = "(.*)"$', page, re.MULTILINE)
    point = EntryPoint("rectified_current", value, library.GROUP)
    monkeypatch.setattr(library, "entry_points", lambda group: [*entry_points(group=group), point])
    library.installed_effects.cache_clear()
    yield
    library.installed_effects.cache_clear()


def test_the_example_is_found_where_it_is_the_cause(with_example, recording, cross):
    """An effect that came by an entry point is tried beside ours, and named with its parameters.

    The current has no period: a tone would explain the size of one that has.
    """
    current = 5 * np.sin(np.cumsum(np.random.default_rng(4).uniform(0.02, 0.3, 600)))
    readings = recording.readings_T.copy()
    readings[:, 2, 0] += 2e-9 * np.abs(current)
    gap = diagnose(Recording(recording.time_s, readings, recording.scalar_T, None, current), cross)
    assert gap.causes[0].fitted.effect == "rectified_current"
    (contribution,) = gap.causes[0].fitted.contributions
    assert (contribution.sensor, contribution.axis) == (2, 0)
    error = contribution.standard_errors["per ampere"]
    assert abs(contribution.values["per ampere"] - 2e-9) < 4 * error < 1e-9
