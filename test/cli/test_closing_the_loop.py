"""From a gap to a calibration that keeps its cause, corrected data without it, and a twin that shows the same gap."""

import json
from dataclasses import replace

import numpy as np
import pytest
from commands import tam as run

from tam_calibration.fit import calibrate
from tam_calibration.recordings import read_array, read_recording, write_array
from tam_calibration.results import read_calibration, write_recording
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate


def diagnosed(*arguments, code=0):
    """Return the gap file of `tam diagnose`."""
    return json.loads(run("diagnose", *arguments, "--json", "-", code=code).stdout)


@pytest.fixture(scope="module")
def drifting():
    """Return the simulated run of a sensor that drifts, 600 samples."""
    scenario = read_scenario("warming_up")
    return simulate(replace(scenario, sample_count=600, rate_hz=3.0))


@pytest.fixture(scope="module")
def files(tmp_path_factory, drifting):
    """Return a folder with that run as CSV and as a bag, the array, and the calibration that keeps the drift."""
    folder = tmp_path_factory.mktemp("drifting")
    write_array(folder / "array.yaml", drifting.scenario.array)
    for name in ("run.csv", "run"):
        write_recording(folder / name, drifting.recording)
    arguments = ("calibrate", folder / "run.csv", "--array", folder / "array.yaml", "-o", folder / "kept.yaml")
    run(*arguments, "--effects", "temperature_drift")
    return folder


def test_a_drift_is_found_kept_taken_off_and_shown_by_the_twin(folder, drifting, undrawn):
    """Simulate, diagnose, calibrate with the effect, correct, diagnose what is left, simulate the twin, diagnose it."""
    truth = drifting.center_field_T
    gap = diagnosed("run.csv", "--array", "array.yaml")
    assert gap["verdict"] == "explained"
    assert [cause["effect"] for cause in gap["causes"]] == ["temperature_drift"]

    words = ("run.csv", "--array", "array.yaml", "--effects", "auto", "-o", "c.yaml", "--report", "c.html")
    assert "Effects fitted too: temperature_drift in sensor 2." in run("calibrate", *words).stdout
    assert [fitted.effect for fitted in read_calibration("c.yaml").effects] == ["temperature_drift"]
    assert "temperature_drift" in (folder / "c.html").read_text()

    run("correct", "run.csv", "--calibration", "c.yaml", "-o", "corrected.csv")
    corrected = np.loadtxt("corrected.csv", delimiter=",", skiprows=1)[:, 1:4] / 1e9
    recording = read_recording("run.csv")
    plain = calibrate(recording, read_array("array.yaml")).correct(recording).outputs[:, :3]
    left, left_by_plain = (np.sqrt(np.mean((field[:, 0] - truth[:, 0]) ** 2)) for field in (corrected, plain))
    noise = 1e-9 / 2  # of the mean of four sensors
    assert left < 1.1 * noise
    assert left_by_plain > 1.5 * noise

    rest = diagnosed("run.csv", "--array", "array.yaml", "--calibration", "c.yaml")
    assert rest["verdict"] == "no_gap"

    run("simulate", "--from-calibration", "c.yaml", "--recording", "run.csv", "--seed", "7", "-o", "twin.csv")
    twin = diagnosed("twin.csv", "--array", "twin.array.yaml")
    assert [cause["effect"] for cause in twin["causes"]] == ["temperature_drift"]
    assert twin["where"]["sensors"] == gap["where"]["sensors"] == [2]
    assert twin["gap"]["before"] == pytest.approx(gap["gap"]["before"], rel=0.1)


def test_a_scenario_gets_the_calibration_of_an_array(folder):
    """The twin on the motion of a scenario has the errors and effects of the calibration."""
    run("simulate", "warming_up", "--from-calibration", "kept.yaml", "-o", "twin.csv")
    calibration = read_calibration("kept.yaml")
    scenario = read_scenario("warming_up")
    plan = replace(scenario, array=calibration.array, errors=calibration.errors, effects=calibration.effects)
    np.testing.assert_allclose(
        read_recording("twin.csv").readings_T, simulate(plan).recording.readings_T, rtol=0, atol=1e-18
    )


@pytest.mark.parametrize(
    ("effects", "code", "words"),
    [
        ("tides", 2, "there is no effect 'tides'"),
        (",", 2, "--effects names none"),
        ("current_interference", 2, "needs the current channel, which is not recorded"),
        ("auto,hysteresis", 2, "name no others beside it"),
        ("saturation", 1, "is not in this recording"),
    ],
)
def test_effects_that_cannot_be_fitted_are_refused_in_one_sentence(folder, effects, code, words):
    """What is not known, lacks its channel or is not there: the sentence says which, and no file is written."""
    result = run("calibrate", "run.csv", "--array", "array.yaml", "--effects", effects, "-o", "c.yaml", code=code)
    assert words in result.output
    assert not (folder / "c.yaml").exists()


def test_effects_belong_to_the_default_method(folder):
    """Another method is refused."""
    arguments = ("calibrate", "run.csv", "--array", "array.yaml", "--effects", "temperature_drift")
    assert "maximum_likelihood can" in run(*arguments, "--method", "lossless", code=2).stderr


def test_a_recording_without_the_channel_is_not_corrected(folder, drifting):
    """A calibration that keeps a drift refuses a recording without temperature, and names what is missing."""
    write_recording("bare.csv", replace(drifting.recording, temperature_C=None))
    result = run("correct", "bare.csv", "--calibration", "kept.yaml", "-o", "out.csv", code=2)
    assert "temperature_drift is to be taken off, which needs the temperature" in result.stderr


def test_bags_and_tables_are_corrected_alike(folder):
    """The temperature of a bag's topic and that of a table's column give the same results."""
    tables = []
    for source in ("run.csv", "run"):
        run("correct", source, "--calibration", "kept.yaml", "-o", f"{source}.out.csv")
        tables.append(np.loadtxt(f"{source}.out.csv", delimiter=",", skiprows=1))
    np.testing.assert_allclose(tables[1][:, 1:], tables[0][:, 1:], rtol=1e-9, atol=1e-9)


def test_simulate_says_what_it_needs(folder):
    """Neither scenario nor run, or both, is refused."""
    assert "say what to simulate" in run("simulate", "-o", "x.csv", code=2).stderr
    assert "--from-calibration" in run("simulate", "--recording", "r.csv", "-o", "x.csv", code=2).stderr
