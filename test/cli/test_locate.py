"""`tam locate`: steady and alternating sources found from a recording and its calibration."""

import csv
import json

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.cli.main import main
from tam_calibration.fit import calibrate
from tam_calibration.localization.euler import DIPOLE_INDEX
from tam_calibration.localization.locate import locate_run
from tam_calibration.localization.turned_samples import Samples, regional_of
from tam_calibration.model.recording import Recording
from tam_calibration.results import read_calibration, write_calibration, write_recording
from tam_calibration.sources.dipole import Dipole

PASSED = [30.0, 2.5, -2.3]
COIL = Dipole(np.array([2.4, -1.0, 0.46]), np.array([300.0, -200.0, 250.0]))
EARTH_T = np.array([1e-6, 21e-6, -43e-6])


def coil(turns, sample_time, cross, true_errors):
    """Return the recording of a coil of 10 Hz by an array that is turned about its centre."""
    matrix = turns.as_matrix()
    sensors = np.einsum("nij,kj->nki", matrix, cross.positions_m)
    world = EARTH_T + np.sin(2 * np.pi * 10 * sample_time)[:, None, None] * COIL.field_T(sensors)
    fields = np.einsum("nji,nkj->nki", matrix, world)
    noise = 1e-9 * np.random.default_rng(10).normal(size=fields.shape)
    return Recording(sample_time, true_errors.distort(fields) + noise, attitude=turns.as_quat())


@pytest.fixture(scope="module")
def folder(tmp_path_factory, recording, cross, true_errors, passing):
    """Return a folder with a calibration, a pass of a dipole, and a coil seen in four headings and while turning."""
    folder = tmp_path_factory.mktemp("locate")
    write_calibration(folder / "c.yaml", calibrate(recording, cross))
    write_recording(folder / "pass.csv", passing)
    write_recording(folder / "bare.csv", Recording(passing.time_s, passing.readings_T))
    time = np.arange(800) / 100
    headings = Rotation.from_euler("z", np.repeat(np.arange(4), 200)[:, None] * np.pi / 2)
    seen = coil(headings, time, cross, true_errors)
    write_recording(folder / "coil.csv", seen)
    first = seen.take(slice(0, 200))
    write_recording(folder / "one.csv", Recording(first.time_s, first.readings_T))
    spin = Rotation.from_euler("zyx", np.stack([time / 2, 0.2 * np.sin(time), 0.2 * np.cos(time)], axis=1))
    write_recording(folder / "spin.csv", coil(spin, time, cross, true_errors))
    return folder


def run(folder, name, *words):
    """Run the command."""
    return CliRunner().invoke(main, ["locate", str(folder / name), "--calibration", str(folder / "c.yaml"), *words])


@pytest.fixture
def dipoles_alone(monkeypatch):
    """Leave out the fits of other kinds of alternating sources, which take most of the time and change no dipole's."""
    monkeypatch.setattr("tam_calibration.localization.alternating.SOURCES", (DIPOLE_INDEX,))


def test_the_first_line_is_the_answer(folder, dipoles_alone):
    """Where the source is, in one line; few lines follow, unless all are asked for."""
    words = ("one.csv", "--find-frequency")
    first, *others = run(folder, *words).stdout.splitlines()
    assert first.startswith("A source is ") and len(others) < 20
    assert run(folder, *words, "-q").stdout == f"{first}\n"
    assert len(run(folder, *words, "-v").stdout.splitlines()) > len(others)


def result_of(folder, name, *words):
    """Return the JSON of the command."""
    result = run(folder, name, *words, "--json")
    assert result.exit_code == 0, result.stderr
    return json.loads(result.stdout)


def agrees(found, position_m, deviations=5.0):
    """Return whether a position is the true one within its standard errors."""
    return np.abs(np.subtract(found["position_m"], position_m) / found["position_standard_errors_m"]).max() < deviations


@pytest.fixture(scope="module")
def printed(folder):
    """Return what is printed of the pass with an exact velocity; its JSON and its page are written."""
    outputs = ("--json", str(folder / "pass.json"), "--report", str(folder / "page.html"))
    result = run(folder, "pass.csv", "--velocity", "1.5,0,0", "--velocity-error", "0", *outputs)
    assert result.exit_code == 0, result.stderr
    return result.stdout


@pytest.fixture(scope="module")
def passed_by(folder, printed):
    """Return that JSON."""
    return json.loads((folder / "pass.json").read_text())


def test_a_passed_dipole_is_found_from_the_whole_track(passed_by):
    """With the velocity all samples give one target, to millimetres and within its errors."""
    [target] = passed_by["targets"]
    errors = np.array(target["standard_error_m"])
    assert (np.abs(np.subtract(target["position_m"], PASSED)) < 5 * errors).all()
    assert errors.max() < 1e-2 and not target["extended"] and target["misfit"] < 1.5
    spread = np.array(target["moment_standard_error_A_m2"])
    assert (np.abs(np.subtract(target["moment_A_m2"], [40, -60, 150])) < 5 * spread).all() and spread.max() < 2
    assert_allclose(np.sqrt(np.diag(target["position_covariance_m2"])), errors)


def test_a_velocity_is_not_exact_unless_it_is_said_to_be(folder):
    """A tenth of the speed is its error: one that is off by 3 % leaves the target within its errors."""
    [target] = result_of(folder, "pass.csv", "--velocity", "1.455,0,0")["targets"]
    assert (np.abs(np.subtract(target["position_m"], PASSED)) < 5 * np.array(target["standard_error_m"])).all()


def test_lines_give_one_list(folder, passing, tmp_path):
    """Two recordings of one pass show one target, which the CSV has; the GeoJSON is of one of them."""
    passing = passing.take(slice(200, 600, 2))
    still = np.outer(passing.time_s - 1.7e9, [1.5, 0, 0])
    for name, begin in (("first.csv", 1.0), ("second.csv", 1.0)):
        moved = Recording(passing.time_s, passing.readings_T, attitude=passing.attitude, position_m=still + begin)
        write_recording(folder / name, moved)
    second, more = str(folder / "second.csv"), ("--position-drift-m", "0.1", "--origin", "54.3,10.1")
    for table, others in (("list.csv", (second,)), ("list.geojson", ())):
        result = run(folder, "first.csv", *others, *more, "--targets", str(tmp_path / table))
        assert result.exit_code == 0, result.stderr
        assert result.stdout.startswith("1 target along the line")
    [row] = csv.DictReader((tmp_path / "list.csv").read_text().splitlines())
    assert row["lines"] == "2" and row["kind"] == "dipole" and float(row["repeat_m"]) < 1e-6
    assert_allclose([float(row[f"{axis}_m"]) for axis in "xyz"], np.add(PASSED, 1.0), atol=0.1)
    [feature] = json.loads((tmp_path / "list.geojson").read_text())["features"]
    longitude, latitude, height = feature["geometry"]["coordinates"]
    assert latitude == pytest.approx(54.3 + 3.5 / 111_320, abs=2e-6)
    assert longitude == pytest.approx(10.1 + 31.0 / 65_100, abs=2e-6) and height == pytest.approx(-1.3, abs=0.1)


def test_each_sample_of_a_pass_counts_from_the_array(folder, passing):
    """Without a track the samples are those of a run, beside the field that it tells better than its median does."""
    result = run(folder, "pass.csv", "--attitude-noise-deg", "0.001", "--json", str(folder / "samples.json"))
    assert result.exit_code == 0 and result.stdout.startswith("A source is "), result.output
    found = json.loads((folder / "samples.json").read_text())
    calibration = read_calibration(folder / "c.yaml")
    outputs = calibration.correct(passing).outputs
    prior = regional_of(outputs, passing.attitude, np.pi / 180e3)
    offline, regional = locate_run(
        Samples(outputs, calibration.array, calibration.output_covariance, passing.attitude), prior
    )
    assert_allclose(found["regional_field_T"], regional.field_T, rtol=1e-6)
    assert np.abs(regional.field_T - EARTH_T).max() < np.abs(prior.field_T - EARTH_T).max()
    assert [sample["status"] == "located" for sample in found["samples"]] == offline.is_located.tolist()
    positions = [sample["position_m"] for sample in found["samples"] if sample["status"] == "located"]
    assert_allclose(positions, offline.position_m[offline.is_located], rtol=1e-5)
    nearest = found["samples"][400]
    assert agrees(nearest, [0.0, 2.5, -2.3])
    assert found["located"] + sum(found["refused"].values()) == 600


def test_poses_of_an_alternating_source(folder, dipoles_alone):
    """Its frequency is found; each pose in which the array stood still has a position, and all have one together."""
    found = result_of(folder, "coil.csv", "--find-frequency")
    assert found["frequency_Hz"] == pytest.approx(10, abs=5 * found["frequency_standard_error_Hz"])
    assert len(found["samples"]) == 4
    assert all(agrees(sample, COIL.position_m) for sample in found["samples"])
    assert agrees(found["overall"], COIL.position_m)
    assert max(found["overall"]["position_standard_errors_m"]) < 1e-3


def test_without_attitude_the_frame_is_the_array_s(folder, dipoles_alone):
    """One pose, no world."""
    found = result_of(folder, "one.csv", "--frequency", "10")
    assert found["frame"].startswith("array frame")
    assert agrees(found["samples"][0], COIL.position_m)


def test_an_array_that_never_stands_still(folder, dipoles_alone):
    """Field and gradient are demodulated as they turn; the error of finite baselines is left, and printed."""
    result = run(folder, "spin.csv", "--frequency", "10", "--json", str(folder / "spin.json"))
    assert "never stood still" in result.stdout
    [sample] = json.loads((folder / "spin.json").read_text())["samples"]
    assert_allclose(sample["position_m"], COIL.position_m, atol=0.04 * np.linalg.norm(COIL.position_m))


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("coil.csv", "--frequency", "10", "--index", "2"), "not those of one line of dipoles"),
        (("pass.csv", "--index", "1"), "not those of"),
        (("pass.csv", "--index", "2"), "give the place, at which it is that of IGRF"),
        (("pass.csv", "--index", "1", "--attitude-noise-deg", "0.1"), "with an exact attitude alone"),
    ],
)
def test_a_dipole_is_no_line(folder, arguments, reason):
    """Neither a coil nor a wreck is located as a line, and the reason is printed."""
    result = run(folder, *arguments)
    assert result.exit_code == 1
    assert reason in " ".join(result.stdout.split())


def test_a_frequency_that_is_off_is_told(folder, dipoles_alone):
    """Over eight seconds by a sixth of a turn; over two it was rounded, and the one that is found is taken."""
    result = run(folder, "spin.csv", "--frequency", "10.02")
    assert result.exit_code == 1
    assert "the phase advances by" in result.stdout and "State 10 Hz" in result.stdout
    assert result_of(folder, "coil.csv", "--frequency", "10.02")["frequency_Hz"] == pytest.approx(10, abs=1e-4)


def test_two_coils_are_told(folder, cross, true_errors):
    """Of another phase and of the same one."""
    time, second = np.arange(800) / 100, Dipole(np.array([-2.0, 1.5, 1.0]), np.array([100.0, 150.0, -200.0]))
    headings = Rotation.from_euler("z", np.repeat(np.arange(4), 200)[:, None] * np.pi / 2)
    first, matrix = coil(headings, time, cross, true_errors), headings.as_matrix()
    field = np.einsum("nji,nkj->nki", matrix, second.field_T(np.einsum("nij,kj->nki", matrix, cross.positions_m)))
    added = np.einsum("kij,nkj->nki", true_errors.matrix, field)
    for phase, reason in ((1.0, "there are two sources"), (0.0, "the amplitudes are not those of one dipole")):
        swing = np.sin(2 * np.pi * 10 * time + phase)[:, None, None]
        both = Recording(time, first.readings_T + swing * added, attitude=first.attitude)
        write_recording(folder / "two.csv", both)
        result = run(folder, "two.csv", "--frequency", "10")
        assert result.exit_code == 1 and reason in " ".join(result.stdout.split())


def test_table_and_page(folder, printed):
    """The terminal has a row for the target, the page its map."""
    assert "dipole" in printed and f"written: {folder / 'page.html'}" in printed
    assert "Map of the lines and their targets" in (folder / "page.html").read_text()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("bare.csv",), "has no attitude"),
        (("pass.csv", "--velocity", "1.5"), "--velocity must be X,Y,Z"),
        (("pass.csv", "--velocity", "nan,0,0"), "--velocity must be X,Y,Z"),
        (("pass.csv", "--velocity", "1e308,0,0"), "the velocity is 1e+308 m/s, and lies within 0 to 10000 m/s"),
        (("pass.csv", "--velocity", "0,1e300,1e300"), "the velocity is 1e+300 m/s, and lies within 0 to 10000 m/s"),
        (("pass.csv", "--velocity", "1,0,0", "--velocity-error", "1e9"), "the error of the velocity is 1e+09 m/s"),
        (("pass.csv", "--velocity", "1,0,0", "--index", "2"), "its structural index is 3"),
        (("pass.csv", "--velocity", "1,0,0", "--velocity-error", "-1"), "--velocity-error is that of --velocity"),
        (("pass.csv", "--velocity", "1,0,0", "--velocity-error", "nan"), "--velocity-error is that of --velocity"),
        (("pass.csv", "--velocity-error", "0.1"), "--velocity-error is that of --velocity"),
        (("pass.csv", "--velocity", "1,0,0", "--place", "54,10,2024-01-01"), "leave out --place"),
        (("pass.csv", "--targets", "list.txt"), "must end in .csv or .geojson"),
        (("pass.csv", "--targets", "list.geojson"), "state --origin"),
        (("pass.csv", "--targets", "list.csv"), "--targets and --grid are of survey lines"),
        (("pass.csv", "--origin", "here"), "--origin must be LAT,LON"),
        (("pass.csv", "--origin", "100,10"), "--origin must be a latitude"),
        (("pass.csv", "--position-drift-m", "1"), "of which there are none"),
        (("pass.csv", "--index", "0"), "structural index must be 3 of a dipole"),
        (("pass.csv", "--place", "here"), "a place must be LAT,LON,DATE"),
        (("pass.csv", "--attitude-noise-deg", "-1"), "must not be negative"),
        (("pass.csv", "--attitude-noise-deg", "nan"), "must not be negative, nor above 180, not nan"),
        (("pass.csv", "--attitude-noise-deg", "1e300"), "nor above 180"),
        (("coil.csv", "--frequency", "10", "--find-frequency"), "either given or found"),
        (("coil.csv", "--frequency", "10", "--velocity", "1,0,0"), "are for steady sources"),
        (("coil.csv", "--frequency", "80"), "cannot be told from another frequency"),
        (("coil.csv", "--frequency", "0"), "must be a positive number"),
        (("coil.csv", "--frequency", "nan"), "must be a positive number"),
        (("coil.csv", "--frequency", "-10"), "must be a positive number"),
        (("coil.csv", "--frequency", "1e308"), "must be a positive number of hertz, at most 1e+06, not 1e+308"),
        (("coil.csv", "--frequency", "inf"), "must be a positive number of hertz, at most 1e+06, not inf"),
        (("one.csv", "--frequency", "0.01"), "a record of one period at least"),
        (("few.csv", "--find-frequency"), "samples"),
        (("single.csv", "--frequency", "10"), "samples"),
        (("nothing.csv",), "nothing.csv"),
    ],
)
def test_bad_input_is_one_sentence(folder, arguments, sentence, passing):
    """Exit code 2, and what would mend it; no page is left."""
    write_recording(folder / "few.csv", passing.take(slice(0, 4)))
    write_recording(folder / "single.csv", passing.take(slice(0, 1)))
    result = run(folder, *arguments, "--report", str(folder / "bad.html"))
    assert result.exit_code == 2, (result.stdout, result.stderr, result.exception)
    assert result.stdout == "" and len(result.stderr.splitlines()) == 1
    assert result.stderr.startswith("tam: ") and sentence in result.stderr
    assert not (folder / "bad.html").exists()


def test_a_tiny_error_of_the_velocity_is_none(folder, passed_by):
    """Its square would be no number: the track is that of an exact velocity."""
    assert passed_by == result_of(folder, "pass.csv", "--velocity", "1.5,0,0", "--velocity-error", "1e-300")


def test_nothing_to_be_found_is_exit_1(folder, passing):
    """Noise alone has neither a line nor a source; the sentence says so."""
    write_recording(folder / "far.csv", passing.take(slice(0, 60)))
    for words, sentence in (((), "no source can be located"), (("--find-frequency",), "no line exceeds the noise")):
        result = run(folder, "far.csv", *words)
        assert result.exit_code == 1 and sentence in result.stdout
