"""What a user of Python imports from the top of the package."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import tam_calibration

ROOT = Path(__file__).parents[1]


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


@pytest.mark.parametrize("name", ["calibrate", "correct", "diagnose", "locate"])
def test_functions_document_what_they_take_return_and_raise(name):
    """In sections of numpydoc."""
    text = getattr(tam_calibration, name).__doc__
    assert all(
        re.search(rf"^ *{section}\n *-+$", text, re.MULTILINE) for section in ("Parameters", "Returns", "Raises")
    )


def test_the_example_of_the_readme_runs(tmp_path):
    """As it stands there, beside what ``tam simulate`` writes."""
    run = [sys.executable, "-m", "tam_calibration"]
    subprocess.run([*run, "simulate", "wu_table_1", "-o", "run.csv"], cwd=tmp_path, check=True, capture_output=True)
    (example,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    done = subprocess.run([sys.executable, "-c", example], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "no_gap" in done.stdout and (tmp_path / "calibration.yaml").exists()


def test_a_simulated_run_is_corrected_to_its_truth():
    """The names work together: what was simulated comes back within its standard errors."""
    made = tam_calibration.simulate(tam_calibration.read_scenario("wu_table_1"))
    calibration = tam_calibration.calibrate(made.recording, made.scenario.array)
    corrected = tam_calibration.correct(made.recording, calibration)
    assert corrected.outputs.shape == (made.recording.sample_count, 9)
    off = np.linalg.norm(corrected.outputs[:, :3], axis=1) - np.linalg.norm(made.center_field_T, axis=1)
    assert np.sqrt(np.mean(off**2)) < 3 * np.linalg.norm(corrected.standard_errors[:3])
