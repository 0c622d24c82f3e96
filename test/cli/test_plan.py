"""`tam plan`: poses and their promise for people and programs; what cannot be planned is one sentence."""

import json
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from click.testing import CliRunner
from commands import tam

from tam_calibration.cli.main import main
from tam_calibration.fit import calibrate
from tam_calibration.model.units import from_degrees
from tam_calibration.recordings import write_array
from tam_calibration.results import write_calibration, write_recording
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate


@pytest.fixture(scope="module")
def narrow():
    """Return the run of a vehicle with 15° of pitch and roll, with attitude."""
    scenario = read_scenario("auv")
    motion = replace(scenario.motion, pitch_limit=from_degrees(15.0), roll_limit=from_degrees(15.0))
    return simulate(replace(scenario, motion=motion, sample_count=750, drift=None))


@pytest.fixture(scope="module")
def files(tmp_path_factory, narrow):
    """Return a folder with the recording and its array file."""
    folder = tmp_path_factory.mktemp("plan")
    write_recording(folder / "run.csv", narrow.recording)
    write_array(folder / "array.yaml", narrow.scenario.array)
    return folder


run = partial(tam, "plan", "--array", "array.yaml")


def read(*arguments):
    """Run the command and return its JSON."""
    return json.loads(run(*arguments, "--json").stdout)


VEHICLE = ("--pitch-limit-deg", "30", "--roll-limit-deg", "30")


def test_people_see_poses_and_standard_errors(folder):
    """Poses, standard errors with the worst parameters' names, the field, and whether it is enough."""
    out = run("run.csv", *VEHICLE, "--poses", "6").stdout
    for words in ("yaw (°)", "pitch (°)", "roll (°)", "field points", "facing magnetic north", "before", "after"):
        assert words in out
    for words in ("bias (nT)", "(z of sensor ", "75° down (from the recorded attitude)", "enough", "100 samples each"):
        assert words in out
    assert sum(re.match(r"│ \d", line) is not None for line in out.splitlines()) == 6


def test_programs_get_json(folder):
    """The JSON holds as many poses as asked, within the limits, and standard errors that fall."""
    plan = read("run.csv", *VEHICLE, "--poses", "5", "--samples-per-pose", "40")
    assert len(plan["poses"]) == 5 and plan["samples_per_pose"] == 40
    angles = np.array([[pose["pitch_deg"], pose["roll_deg"]] for pose in plan["poses"]])
    assert (np.abs(angles) <= 30 + 1e-9).all()
    assert np.linalg.norm([pose["field_direction"] for pose in plan["poses"]], axis=1) == pytest.approx(1)
    worst = plan["worst_standard_error_in_noise"]
    assert worst["after"] < worst["before"] / 3 and plan["enough"]
    before, after = (
        np.array([sensor["bias_nT"] for sensor in plan[f"standard_errors_{when}"]]) for when in ("before", "after")
    )
    assert (after < before).all()


def test_from_nothing_before_is_open(folder):
    """A whole calibration is planned from the array file alone, and what was assumed is said."""
    result = run("--turntable", "30")
    assert "open" in result.stdout
    assert "The intensity of the field is assumed" in result.stdout
    assert "60° down (assumed: give --place)" in result.stdout
    plan = read("--turntable", "30,60,60")
    assert plan["standard_errors_before"] is None and plan["worst_standard_error_in_noise"]["before"] is None
    assert all(pose["yaw_deg"] % 30 == 0 for pose in plan["poses"])


def test_a_calibration_stands_for_its_recording(folder, narrow):
    """The plan from a calibration is that from its recording."""
    write_calibration("c.yaml", calibrate(narrow.recording, narrow.scenario.array))
    site = ("--place", "63.47,10.35,2025-06-01")
    plans = [read(*source, *site, *VEHICLE) for source in (("--calibration", "c.yaml"), ("run.csv",))]
    yaws = [[pose["yaw_deg"] for pose in plan["poses"]] for plan in plans]
    assert yaws[0] == yaws[1]
    after = [plan["worst_standard_error_in_noise"]["after"] for plan in plans]
    assert after[0] == pytest.approx(after[1], rel=1e-5)


def test_a_place_gives_the_field(folder):
    """Inclination and intensity are those of the geomagnetic model."""
    field = read("--place", "63.47,10.35,2025-06-01", *VEHICLE)["field"]
    assert field["inclination_deg"] == pytest.approx(75.0, abs=0.5)
    assert field["intensity_nT"] == pytest.approx(52_240, rel=0.01)


def test_a_place_gives_the_scale_of_a_recording_without_scalar(folder, narrow):
    """Without a scalar the intensity is fitted; with a place it is that of the model."""
    write_recording("bare.csv", replace(narrow.recording, scalar_T=None))
    known = read("bare.csv", "--place", "63.47,10.35,2025-06-01", *VEHICLE)
    assert known["field"]["intensity_nT"] == pytest.approx(52_240, rel=0.01)
    assert read("bare.csv", *VEHICLE)["worst_standard_error_in_noise"]["after"] > 0


def test_a_level_vehicle_is_refused(folder):
    """Limits of 0 exit 1 with the names of what stays open."""
    sentence = run("--pitch-limit-deg", "0", "--roll-limit-deg", "0", code=1).stderr
    assert "do not determine scale factor x" in sentence and "bias z of every sensor" in sentence
    assert len(sentence.strip().splitlines()) == 1


def test_not_yet_enough_is_said(folder):
    """A plan that determines everything, but badly, says so."""
    plan = ("--pitch-limit-deg", "8", "--roll-limit-deg", "8", "--poses", "9", "--samples-per-pose", "30")
    assert "not yet enough: plan more poses" in " ".join(run(*plan).stdout.split())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "say what can be reached"),
        (("--turntable", "30", *VEHICLE), "say what can be reached"),
        (("--turntable", "ten"), "--turntable must be one step in degrees"),
        (("--turntable", "30,30"), "--turntable must be one step in degrees"),
        (("--turntable", "-5"), "steps of a turntable"),
        (("--turntable", "0.000001"), "steps of a turntable"),
        (("--turntable", "30,inf,60"), "--turntable must be one step in degrees"),
        (("--pitch-limit-deg", "120"), "the pitch limit must lie between 0 and 90"),
        (("--turntable", "30", "--place", "47,8"), "a place must be LAT,LON,DATE"),
        (("run.csv", "--calibration", "c.yaml", "--turntable", "30"), "either a recording or --calibration"),
        (("nowhere.csv", "--turntable", "30"), "nowhere.csv"),
        (("--calibration", "array.yaml", "--turntable", "30"), "array.yaml"),
    ],
)
def test_bad_input_is_one_sentence(folder, arguments, words):
    """What cannot be used exits 2 with the reason."""
    sentence = run(*arguments, code=2).stderr
    assert words in sentence and len(sentence.strip().splitlines()) == 1


def test_a_calibration_of_another_array(folder, narrow):
    """A calibration of sensors at other places does not pass for one of this array."""
    calibration = calibrate(narrow.recording, narrow.scenario.array)
    moved = replace(calibration.array, positions_m=2 * calibration.array.positions_m)
    write_calibration("c.yaml", replace(calibration, array=moved))
    assert "another array" in run("--calibration", "c.yaml", "--turntable", "30", code=2).stderr


def test_calibrate_names_what_is_badly_determined(folder, recording, cross):
    """`tam calibrate` tells of parameters far from the full sphere's standard errors, and is silent otherwise."""
    said = CliRunner().invoke(main, ["calibrate", "run.csv", "--array", "array.yaml"]).stdout
    assert "Badly determined" in said and "bias z of every sensor" in said
    assert "pitch and roll further" in " ".join(said.split())
    write_recording("round.csv", recording)
    write_array("array.yaml", cross)
    silent = CliRunner().invoke(main, ["calibrate", "round.csv", "--array", "array.yaml"])
    assert silent.exit_code == 0 and "Badly determined" not in silent.stdout


def test_the_report_names_it_too(folder, undrawn):
    """The report's section on coverage says the same."""
    CliRunner().invoke(main, ["calibrate", "run.csv", "--array", "array.yaml", "--report", "page.html"])
    assert "Badly determined, in standard errors of the full sphere: bias z of every sensor" in (
        folder / "page.html"
    ).read_text().replace("\N{NO-BREAK SPACE}", " ")


def test_intensity_scales_angles(folder):
    """Near the magnetic pole the field is three times that at Rio: angles have a third of the standard error."""
    weak, strong = (
        read("--place", place, "--turntable", "30") for place in ("-22.9,-43.2,2025-01-01", "-65,140,2025-01-01")
    )
    ratio = strong["field"]["intensity_nT"] / weak["field"]["intensity_nT"]
    assert ratio == pytest.approx(2.9, abs=0.1)
    errors = [plan["standard_errors_after"][0]["non_orthogonality_deg"] for plan in (weak, strong)]
    assert np.array(errors[0]) == pytest.approx(ratio * np.array(errors[1]), rel=0.1)
