"""What a user of Python imports from the top of the package."""

import doctest
import inspect
import re
from functools import cached_property
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from numpydoc.validate import Validator, validate

import tam_calibration
from tam_calibration.cli.main import main

ROOT = Path(__file__).parents[1]

RESULTS = (
    "tam_calibration.comparison.result.Comparison",
    "tam_calibration.correction.parts.Corrected",
    "tam_calibration.gap.result.Gap",
    "tam_calibration.localization.solutions.Survey",
    "tam_calibration.model.sensor_errors.ResidualSeries",
    "tam_calibration.recordings.inspection.Inspection",
    "tam_calibration.simulation.observe.Simulation",
    "tam_calibration.simulation.observe.Scenario",
)
"""Classes that the public functions return without being public names themselves."""

CHECKED = {
    *("GL06", "GL07", "GL08", "SS01", "SS02", "SS03", "SS04", "PR01", "PR02", "PR03", "PR04", "PR06", "PR07", "PR09"),
    *("PR10", "RT01", "RT03", "RT05", "YD01"),
}
"""The checks of numpydoc: sections that are known and in order, a summary, parameters, what is returned."""


def documented():
    """Return the public names, the classes of results, and the public methods and properties of the classes."""
    names = [f"tam_calibration.{name}" for name in tam_calibration.__all__]
    names += RESULTS
    for name in tuple(names):
        value = Validator._load_obj(name)
        if inspect.isclass(value) and not issubclass(value, Exception):
            kinds = property, cached_property, classmethod
            names += [
                f"{name}.{each}"
                for each, member in vars(value).items()
                if not each.startswith("_") and (inspect.isfunction(member) or isinstance(member, kinds))
            ]
    return names


DOCUMENTED = documented()


@pytest.mark.parametrize("name", tam_calibration.__all__)
def test_every_name_is_there_and_documented(name):
    """Each public name loads, and its docstring says more than a line."""
    value = getattr(tam_calibration, name)
    assert value.__name__ == name and value.__doc__.strip()
    assert name in dir(tam_calibration)


def test_another_name_is_none():
    """A name that is not there is told as Python tells it."""
    with pytest.raises(AttributeError, match="has no attribute 'nonsense'"):
        _ = tam_calibration.nonsense


@pytest.mark.parametrize("name", DOCUMENTED)
def test_docstrings_are_complete(name):
    """Every parameter is described in the order of the signature, and what is returned; numpydoc finds no fault."""
    needs_example = name in RESULTS or name.removeprefix("tam_calibration.") in tam_calibration.__all__
    checked = CHECKED | ({"EX01"} if needs_example else set())
    assert [fault for fault in validate(name)["errors"] if fault[0] in checked] == []


@pytest.mark.parametrize("name", DOCUMENTED)
def test_examples_give_what_they_say(name, tmp_path, monkeypatch):
    """Each is complete in itself and may write files; the figure that one saves is drawn by that of the README."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda figure, path, **options: None)
    for example in doctest.DocTestFinder(recurse=False).find(Validator._load_obj(name), name, globs={}):
        said = []
        doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(example, out=said.append)
        assert said == []


def test_the_example_of_the_readme_runs(tmp_path, monkeypatch, capsys):
    """As it stands there, beside what ``tam simulate`` writes."""
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(main, ["simulate", "wu_table_1", "-o", "run.csv"]).exit_code == 0
    (example,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    exec(example, {})
    assert "no_gap" in capsys.readouterr().out
    assert all((tmp_path / name).exists() for name in ("calibration.yaml", "residuals.png"))


def test_a_simulated_run_is_corrected_to_its_truth():
    """The names work together: what was simulated comes back within its standard errors."""
    made = tam_calibration.simulate(tam_calibration.read_scenario("wu_table_1"))
    calibration = tam_calibration.calibrate(made.recording, made.scenario.array)
    corrected = tam_calibration.correct(made.recording, calibration)
    assert corrected.outputs.shape == (made.recording.sample_count, 9)
    off = np.linalg.norm(corrected.outputs[:, :3], axis=1) - np.linalg.norm(made.center_field_T, axis=1)
    assert np.sqrt(np.mean(off**2)) < 3 * np.linalg.norm(corrected.standard_errors[:3])
