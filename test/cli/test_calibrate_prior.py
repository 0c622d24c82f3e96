"""`tam calibrate --prior` and `tam plan --prior`: an update during the mission, told to people and programs."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tam_calibration.cli.main import main
from tam_calibration.files.yaml_document import parse_mapping
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.model.array import Array
from tam_calibration.model.data_sheet import Tolerances
from tam_calibration.model.units import from_degrees
from tam_calibration.recordings import read_recording, write_array
from tam_calibration.results import write_calibration, write_recording
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import AttitudeChannel, Manoeuvre

PIER_S = 1.7e9


@pytest.fixture(scope="module")
def files(tmp_path_factory, wu_run, wu_scenario):
    """Return a folder with the pier's calibration and a dive at four degrees in which a bias moved."""
    folder = tmp_path_factory.mktemp("prior")
    write_array(folder / "array.yaml", wu_scenario.array)
    pier = replace(wu_run.recording, time_s=PIER_S + wu_run.recording.time_s)
    write_calibration(folder / "pier.yaml", maximum_likelihood(pier, wu_scenario.array))
    limit = from_degrees(4.0)
    begin = replace(wu_scenario, motion=Manoeuvre(limit, limit, 60.0), sample_count=300, rate_hz=5.0, seed=4)
    dive = simulate(replace(begin, attitude=AttitudeChannel(from_degrees(0.1)))).recording
    readings = dive.readings_T.copy()
    readings[:, 2] += np.array([12e-9, -9e-9, 14e-9])
    write_recording(folder / "dive.csv", replace(dive, readings_T=readings, time_s=PIER_S + 7200 + dive.time_s))
    return folder


def run(*arguments, code=0):
    """Run tam and return what it printed, on one line."""
    result = CliRunner().invoke(main, list(arguments), env={"COLUMNS": "400"})
    assert result.exit_code == code, result.output
    return " ".join(result.output.split())


def test_an_update_is_told_and_kept(folder, undrawn):
    """Age, what moved, the shares; the file says it again, and the page has a section."""
    told = run(
        *("calibrate", "dive.csv", "--array", "array.yaml", "--prior", "pier.yaml"),
        *("-o", "dive.yaml", "--report", "dive.html", "--verbose"),
    )
    assert "2.0" in told and "h old" in told and "temperatures unknown" in told
    assert "The data contradict the prior" in told and "The bias of sensor 3 moved by" in told
    assert "Share of the recording" in told
    moved = parse_mapping(Path("dive.yaml").read_text())["update"]["moved"][0]
    assert (moved["kind"], moved["sensor"]) == ("bias", 3)
    assert "Prior and data" in (folder / "dive.html").read_text()


def test_tolerances_are_a_prior_and_what_they_made_is_the_next(folder, wu_scenario, undrawn):
    """A dive that is refused alone; what is left to the tolerances is told; the file is read, and is a prior itself."""
    assert "do not determine" in run("calibrate", "dive.csv", "--array", "array.yaml", code=2)
    tolerances = Tolerances(0.05, from_degrees(1.0), 3e-6, from_degrees(3.0))
    write_array("sheet.yaml", replace(wu_scenario.array, tolerances=tolerances))
    first = ("calibrate", "dive.csv", "--array", "sheet.yaml")
    told = run(*first, "-o", "first.yaml", "--report", "first.html")
    assert "Prior: the tolerances that the array file states. Data against tolerances: χ²" in told
    assert "this is left to the tolerances of the array file; turn the array further" in told
    update = parse_mapping(Path("first.yaml").read_text())["update"]
    assert update["prior"] == "tolerances" and update["change_rates"] is None and update["freedom"] == 45
    assert "the tolerances that the array file states" in (folder / "first.html").read_text()
    dive = read_recording("dive.csv")
    write_recording("next.csv", replace(dive, time_s=dive.time_s + 600))
    told = run("calibrate", "next.csv", "--array", "sheet.yaml", "--prior", "first.yaml")
    assert "Data and prior agree" in told and "0.158 h old" in told


def test_json_has_the_shares(folder):
    """Data share and changes for programs; with attitude and a place beside the prior too."""
    extra = ("--attitude-noise-deg", "0.1", "--place", "47.4,8.5,2025-06-30")
    for more in ((), extra):
        told = run("calibrate", "dive.csv", "--array", "array.yaml", "--prior", "pier.yaml", "--json", "-", *more)
        update = json.loads(told)["update"]
        assert update["moved"][0]["kind"] == "bias"
        assert len(update["data_share"]) == 4


def test_what_is_no_prior_is_one_sentence(folder):
    """Another array, no calibration, options that do not go together."""
    write_array("other.yaml", Array.cross(0.3, 1e-9, 1e-10))
    calibrate = ("calibrate", "dive.csv", "--prior", "pier.yaml")
    assert "another array" in run(*calibrate, "--array", "other.yaml", code=2)
    assert "no calibration" in run(*calibrate[:2], "--prior", "array.yaml", "--array", "array.yaml", code=2)
    assert "not with lossless" in run(*calibrate, "--array", "array.yaml", "--method", "lossless", code=2)
    assert "--effects" in run(*calibrate, "--array", "array.yaml", "--effects", "auto", code=2)


def test_attitude_that_is_not_there_is_told(folder, wu_run):
    """A noise of attitude for a recording without it."""
    write_recording("bare.csv", wu_run.recording)
    told = run("calibrate", "bare.csv", "--array", "array.yaml", "--attitude-noise-deg", "0.1", code=2)
    assert "attitude" in told


def test_turns_are_planned_beside_a_prior(folder):
    """The one that buys most per minute first; each leaves less than there was."""
    limits = ("--pitch-limit-deg", "10", "--roll-limit-deg", "5")
    told = json.loads(run("plan", "--array", "array.yaml", "--prior", "pier.yaml", *limits, "--json"))
    gains = [turn["gain_per_minute"] for turn in told["turns"]]
    assert gains == sorted(gains, reverse=True) and len(gains) == 15
    assert all(turn["excess_after"] < told["excess_before"] for turn in told["turns"])
    assert all(abs(turn["pitch_deg"]) in (0, pytest.approx(10)) for turn in told["turns"])
    assert "Turns, the one that gains most" in run("plan", "--array", "array.yaml", "--prior", "pier.yaml", *limits)


def test_plans_that_cannot_be_are_one_sentence(folder):
    """A recording beside a prior, a rate without one, a prior of another array."""
    plan = ("plan", "--array", "array.yaml")
    assert "leave out recording" in run(*plan, "dive.csv", "--prior", "pier.yaml", code=2)
    assert "go with --prior" in run(*plan, "--turntable", "30", "--turn-rate-deg-s", "3", code=2)
    write_array("array.yaml", Array.cross(0.3, 1e-9, 1e-10))
    assert "another array" in run(*plan, "--prior", "pier.yaml", "--pitch-limit-deg", "5", code=2)
