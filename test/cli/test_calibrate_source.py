"""`tam calibrate --source`: a known source completes a calibration."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from tam_calibration.cli.main import main
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.recordings import write_array
from tam_calibration.results import write_recording
from tam_calibration.results.calibration_yaml import read_calibration
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate
from tam_calibration.sources.dipole import Loop, area_of

COIL = """# The coil of the field test.
recording: coil.csv
position_m: [2.4, -1.0, 0.46]
axis: [0.5, -0.6, 0.6]
ampere_turns: 708
radius_m: 0.445
frequency_Hz: 10
"""
TRUE_SCALE = 0.96


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with an array whose baselines are stated wrong, its calibration run, and the coil's recording."""
    folder = tmp_path_factory.mktemp("source")
    scenario = replace(read_scenario("wu_turntable"), drift=None)
    write_array(folder / "array.yaml", scenario.array)
    write_recording(folder / "uniform.csv", simulate(scenario).recording)
    axis = np.array([0.5, -0.6, 0.6])
    loop = Loop(np.array([2.4, -1.0, 0.46]), 708 * area_of(0.445) * axis / np.linalg.norm(axis), 0.445)
    turns = Rotation.from_euler("z", np.arange(12)[:, None] * np.pi / 6)
    places = Array.cross(TRUE_SCALE * 0.21).positions_m
    fields = np.array([(turn.inv().apply(loop.field_T(turn.apply(places)))) for turn in turns])
    time, pose = np.arange(12 * 200) / 100, np.repeat(np.arange(12), 200)
    carrier = np.sin(2 * np.pi * 10 * time)[:, None, None]
    earth = turns.inv().apply(scenario.site_field_T)[:, None]
    noise = 1e-10 * np.random.default_rng(71).normal(size=(len(time), 4, 3))
    readings = scenario.errors.distort((earth + 0 * fields)[pose] + carrier * fields[pose]) + noise
    write_recording(folder / "coil.csv", Recording(time, readings, attitude=turns.as_quat()[pose]))
    (folder / "coil.yaml").write_text(COIL)
    return folder


def run(folder, *words):
    """Run the command in the folder."""
    arguments = ["calibrate", str(folder / "uniform.csv"), "--array", str(folder / "array.yaml"), *words]
    return CliRunner().invoke(main, arguments)


def test_baselines_frame_and_places_are_printed_and_kept(folder, tmp_path, undrawn):
    """The file holds the true baselines, the places of the axes, and standard errors."""
    out = tmp_path / "out.yaml"
    page = str(tmp_path / "page.html")
    result = run(folder, "--source", str(folder / "coil.yaml"), "-o", str(out), "--report", page, "--verbose")
    assert result.exit_code == 0, result.stderr
    assert re.search(r"true baselines over stated\W+0\.9", result.stdout)
    found = read_calibration(out)
    assert found.known_source.baseline_scale == pytest.approx(TRUE_SCALE, abs=1e-3)
    assert np.linalg.norm(found.known_source.rotation) < 1e-3
    assert found.array.positions_m[0, 0] == pytest.approx(TRUE_SCALE * 0.105, abs=1e-4)
    assert np.abs(found.array.axis_offsets_m).max() < 2e-3


def test_as_json(folder):
    """What the source showed stands under its own key."""
    result = run(folder, "--source", str(folder / "coil.yaml"), "--json", "-")
    assert json.loads(result.stdout)["known_source"]["baseline_scale"] == pytest.approx(TRUE_SCALE, abs=1e-3)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("position_m: [2.4", "position_m: [1.4", "stated source"),
        ("axis: [0.5, -0.6, 0.6]", "axis: [0, 0, 0]", "must not be zero"),
        ("ampere_turns: 708", "ampere_turns: 708\nmoment_Am2: 3", "either moment_Am2"),
        ("radius_m: 0.445", "", "give its radius_m too"),
        ("frequency_Hz: 10", "frequency_Hz: 1", "stood still nowhere"),
        ("coil.csv", "nothing.csv", "nothing.csv"),
    ],
)
def test_wrong_statements_are_refused_in_one_sentence(folder, tmp_path, old, new, message):
    """Another place than the true one, no direction, two sizes, none, and poses that are too short."""
    stated = tmp_path / "coil.yaml"
    stated.write_text(COIL.replace("coil.csv", str(folder / "coil.csv")).replace(old, new))
    result = run(folder, "--source", str(stated))
    assert result.exit_code in (1, 2)
    assert message in result.output
    assert result.output.count("\n") == 1
    assert not list(Path(tmp_path).glob("*.part"))
