"""`tam calibrate`: tables for people, JSON for programs, files that appear together."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from commands import tam
from numpy.testing import assert_allclose

from tam_calibration.cli.main import main
from tam_calibration.fit import calibrate
from tam_calibration.recordings import write_array
from tam_calibration.results import read_calibration, write_recording
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import AttitudeChannel

run = partial(tam, "calibrate")


@pytest.mark.parametrize("name", ["run.csv", "run"])
@pytest.mark.parametrize("method", ["maximum_likelihood", "lossless"])
def test_the_calibration_is_that_of_the_fit(folder, recording, cross, name, method):
    """The file holds what the fit returns, and which recording it came from."""
    run(name, "--array", "array.yaml", "-o", "c.yaml", "--method", method)
    calibration = read_calibration("c.yaml")
    expected = calibrate(recording, cross, method).errors
    assert_allclose(calibration.errors.to_vector(), expected.to_vector(), rtol=1e-9, atol=1e-15)
    assert calibration.method == method
    assert calibration.source.name == name
    assert calibration.samples == recording.sample_count


@pytest.mark.parametrize("name", ["run.csv", "run"])
def test_it_loads_what_it_needs(folder, name):
    """Without attitude neither SciPy nor the diagnosis, which take as long as the rest; nor what writes bags."""
    code = f"""import atexit, sys
from tam_calibration.cli.main import main
dear = {{"scipy", "tam_calibration.gap", "tam_calibration.recordings.bag_writing"}}
atexit.register(lambda: print("loaded:", *(dear & set(sys.modules)), file=sys.stderr))
main(["calibrate", {name!r}, "--array", "array.yaml", "-o", "c.yaml"])"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and done.stderr.splitlines()[-1].strip() == "loaded:", done.stderr


def test_people_see_parameters_residuals_coverage_and_the_formula(folder):
    """Everything that a person judges a calibration by is printed where that is asked for."""
    out = run("run.csv", "--array", "array.yaml", "-o", "c.yaml", "--verbose").stdout
    for words in (
        "scale factor x",
        "bias z (nT)",
        "sensor 4",
        "±",
        "in sample",
        "held out",
        "noise floor",
        "gxx (nT/m)",
    ):
        assert words in out
    for words in ("% of the sphere seen", "frame of sensor 1", "By hand: Field at a sensor", "written: c.yaml"):
        assert words in out


def test_the_first_line_is_the_answer(folder):
    """By default it is followed by a summary of few lines, which names the next command."""
    out = run("run.csv", "--array", "array.yaml", "-o", "c.yaml").stdout
    first, *others = out.splitlines()
    assert re.fullmatch(r"Good: tensor residual [\d.]+ nT/m on held-out samples, noise floor [\d.]+ nT/m\.", first)
    assert len(others) < 20 and others[-1] == "next: tam correct run.csv --calibration c.yaml -o corrected.csv"
    assert run("run.csv", "--array", "array.yaml", "--quiet").stdout == f"{first}\n"
    assert yaml.safe_load(Path("c.yaml").read_text())["quality"] == {"grade": "good", "reasons": [], "next": []}


def test_an_order_of_the_alphabet_is_doubtful(folder):
    """Names without a number may be in another order; with a map it is that of the map."""
    text = Path("run.csv").read_text()
    for number, name in enumerate(("front", "left", "back", "right"), start=1):
        text = text.replace(f"b{number}", f"{name}_b")
    Path("named.csv").write_text(text)
    told = run("named.csv", "--array", "array.yaml").output
    first, doubtful = (next(line for line in told.splitlines() if word in line) for word in ("taken", "Doubtful: "))
    order = "sensors 1 to 4 are back, front, left, right in alphabetical order, as no number in their names tells"
    assert order in first and order in doubtful
    tam("inspect", "named.csv", "--array", "array.yaml", "--write-map", "map.yaml")
    assert "alphabetical" not in run("named.csv", "--array", "array.yaml", "--map", "map.yaml").output


def test_a_refusal_is_bad(folder, recording):
    """The first line says so with the reason, exit 1, and nothing is written; programs get it as JSON."""
    readings_T = recording.readings_T.copy()
    readings_T[:, 2] = readings_T[:, 1]
    write_recording("bad.csv", replace(recording, readings_T=readings_T))
    line = ["calibrate", "bad.csv", "--array", "array.yaml", "-o", "new.yaml"]
    result = CliRunner().invoke(main, line)
    assert result.exit_code == 1 and result.stdout.startswith("Bad: ") and result.stdout.count("\n") == 1
    quality = json.loads(CliRunner().invoke(main, [*line, "--json", "-"]).stdout)["quality"]
    assert quality["grade"] == "bad" and result.stdout == f"Bad: {quality['reasons'][0]}.\n" and quality["next"]
    assert not Path("new.yaml").exists()
    Path("new.yaml").write_text("earlier")
    again = CliRunner().invoke(main, line)
    assert again.stdout.endswith("; nothing written: new.yaml is still the earlier one.\n")
    assert Path("new.yaml").read_text() == "earlier"


def test_programs_get_json(folder):
    """JSON goes to a file beside the tables, or alone to stdout; it is the content of the calibration file."""
    run("run.csv", "--array", "array.yaml", "--json", "c.json")
    alone = json.loads(run("run.csv", "--array", "array.yaml", "--json", "-").stdout)
    assert json.loads((folder / "c.json").read_text()) == alone
    assert [block["sensor"] for block in alone["sensors"]] == [1, 2, 3, 4]
    assert (
        alone["residuals"]["in_sample"]["tensor_rmse_nT_per_m"]
        < 1.2 * alone["residuals"]["noise_floor"]["tensor_rmse_nT_per_m"]
    )


def test_a_report_is_written(folder, undrawn):
    """The page is HTML of its own."""
    run("run.csv", "--array", "array.yaml", "--report", "page.html")
    assert "<html" in (folder / "page.html").read_text()


def test_a_place_gives_the_intensity_of_a_recording_without_scalar(folder, recording, undiagnosed):
    """Without a scalar the scale is unknown; with a place it is that of IGRF, as words and file say."""
    write_recording("bare.csv", replace(recording, scalar_T=None))
    unknown = json.loads(run("bare.csv", "--array", "array.yaml", "--json", "-").stdout)
    assert not unknown["field"]["has_scalar_reference"]
    known = json.loads(
        run("bare.csv", "--array", "array.yaml", "--json", "-", "--place", "40.1,-105.2,2020-01-01").stdout
    )
    assert not known["field"]["has_scalar_reference"]
    assert_allclose(known["field"]["intensity_nT"], 51_800, rtol=0.02)
    assert known["field"]["reference"] == "IGRF at the place, ± 140 nT"
    told = run("bare.csv", "--array", "array.yaml", "--place", "40.1,-105.2,2020-01-01", "-o", "c.yaml", "-v").stdout
    assert "nT, from IGRF at the place, ± 140 nT; " in told and "of the scalar magnetometer" not in told
    again = read_calibration("c.yaml")
    assert again.has_scalar_reference and again.reference == known["field"]["reference"]


def test_a_gradient_of_the_site_is_fitted_as_an_effect(folder, undrawn, undiagnosed):
    """With attitude the effect gives gradient and errors at the floor, in table, file and report; without, a reason."""
    gradient = 1e-9 * np.array([[120, -80, 60], [-80, -200, 90], [60, 90, 80]])
    scenario = replace(read_scenario("wu_table_1"), site_gradient_T_per_m=gradient, attitude=AttitudeChannel(0.01))
    write_recording("site.csv", simulate(scenario).recording)
    write_array("wu.yaml", scenario.array)
    effects = ("--effects", "ambient_gradient")
    assert "Recorded attitude (noise " in run("site.csv", "--array", "wu.yaml").stdout
    told = run("site.csv", "--array", "wu.yaml", "-o", "c.yaml", "--report", "page.html", *effects, "-v").stdout
    assert "gradient xx" in told and "gradient xx" in (folder / "page.html").read_text()
    calibration = read_calibration("c.yaml")
    (found,) = calibration.effects[0].contributions
    for name, value in found.values.items():
        row, column = map("xyz".index, name.removeprefix("gradient "))
        assert value == pytest.approx(gradient[row, column], abs=1e-9)
    assert calibration.in_sample.tensor_rmse_T_per_m < 1.1 * calibration.floor.tensor_rmse_T_per_m
    refused = CliRunner().invoke(main, ["calibrate", "run.csv", "--array", "array.yaml", *effects])
    assert refused.exit_code == 2
    assert "ambient_gradient cannot be fitted: it needs the attitude" in refused.stderr


def test_the_noise_of_attitude_may_be_estimated(folder):
    """By the option, as by a number; anything else is none."""
    scenario = replace(read_scenario("wu_table_1"), attitude=AttitudeChannel(0.01))
    write_recording("turned.csv", simulate(scenario).recording)
    write_array("wu.yaml", scenario.array)
    arguments = ("turned.csv", "--array", "wu.yaml", "-o", "c.yaml", "--attitude-noise-deg")
    run(*arguments, "estimate")
    assert read_calibration("c.yaml").array.attitude_noise == pytest.approx(0.01, rel=0.1)
    assert CliRunner().invoke(main, ["calibrate", *arguments, "guess"]).exit_code == 2


def write_apart(path, delays_s=(0.0, 0.0, 0.0, 0.0), periods_ms=(10, 10, 10, 10)):
    """Write a bag whose sensors are read some milliseconds after each other and stamped late, and its array file."""
    from tam_calibration.messages.point_cloud import MAGNETIC_FIELD, sensor_topic
    from tam_calibration.recordings.bag_writing import TYPESTORE, serialise, write_bag

    made = simulate(replace(read_scenario("tumble_100_hz"), sample_count=20_000, rate_hz=1000.0))
    with write_bag(path, "sqlite3") as writer:
        for sensor, (delay_s, period_ms) in enumerate(zip(delays_s, periods_ms, strict=True)):
            connection = writer.add_connection(f"/{sensor_topic(sensor + 1)}", MAGNETIC_FIELD, typestore=TYPESTORE)
            own = slice(sensor, None, period_ms)
            stamps_ns = np.round((1e3 + made.recording.time_s[own] + delay_s) * 1e9).astype(int)
            messages = serialise(MAGNETIC_FIELD, made.recording.readings_T[own, sensor], stamps_ns)
            for stamp_ns, message in zip(stamps_ns, messages, strict=True):
                writer.write(connection, int(stamp_ns), message)
    write_array("array.yaml", made.scenario.array)


def test_sensors_that_stamp_apart_are_interpolated(folder, undiagnosed):
    """A bag whose sensors are read 1 ms after each other needs no option; the residual is that of the noise."""
    write_apart(folder / "apart")
    run("apart", "--array", "array.yaml", "-o", "c.yaml")
    calibration = read_calibration("c.yaml")
    assert calibration.samples == 1996
    assert calibration.in_sample.tensor_rmse_T_per_m < 1.05 * calibration.floor.tensor_rmse_T_per_m
    run("apart", "--array", "array.yaml", "-o", "c.yaml", "--tolerance-s", "0.004")
    nearest = read_calibration("c.yaml")
    assert nearest.samples == 2000
    assert nearest.in_sample.tensor_rmse_T_per_m > 10 * calibration.floor.tensor_rmse_T_per_m


def test_sensors_that_are_interpolated_show_no_gap(folder):
    """What is left of them is as white as the noise of readings, also where each of a slower sensor counts once."""
    write_apart(folder / "apart", periods_ms=(10, 20, 20, 20))
    answer = CliRunner().invoke(main, ["diagnose", "apart", "--array", "array.yaml"])
    assert answer.stdout.startswith("No gap"), answer.output


def test_delays_are_estimated_told_and_kept(folder):
    """The calibration keeps them, so that correction takes them off; people see what to write into the array file."""
    write_apart(folder / "late", (0.0, 0.0123, -0.0071, 0.0185))
    result = run("late", "--array", "array.yaml", "-o", "c.yaml", "--estimate-delays", "--json", "c.json")
    calibration, told = read_calibration("c.yaml"), json.loads((folder / "c.json").read_text())["delays"]
    assert calibration.in_sample.tensor_rmse_T_per_m < 1.05 * calibration.floor.tensor_rmse_T_per_m
    error = np.array(told["delay_s"]) - [0, 0.0123, -0.0071, 0.0185]
    assert np.all(np.abs(error) <= 3 * np.array(told["standard_error_s"]))
    assert calibration.array.delay_s.tolist() == told["delay_s"]
    assert "delay_s: [0.000000, 0.0123" in result.stdout.replace("\n", " ")
    corrected = CliRunner().invoke(main, ["correct", "late", "--calibration", "c.yaml", "-o", "out.csv"])
    assert corrected.exit_code == 0
    gradient = np.genfromtxt("out.csv", delimiter=",", skip_header=1)[:, 4:10]
    assert np.sqrt(np.mean(gradient**2)) < 5


@pytest.mark.parametrize("method", ["maximum_likelihood", "lossless"])
def test_a_large_file_is_streamed_to_the_same_result(folder, monkeypatch, method, undrawn):
    """What does not fit into memory is calibrated from disk, with the same file as the result, and the report shows."""
    run("run.csv", "--array", "array.yaml", "-o", "a.yaml", "--method", method)
    monkeypatch.setattr("tam_calibration.recordings.fit_input.MOST_BYTES", 1)
    run("run.csv", "--array", "array.yaml", "-o", "b.yaml", "--method", method, "--report", "page.html")
    assert (folder / "b.yaml").read_text() == (folder / "a.yaml").read_text()
    assert (folder / "page.html").exists()
