"""`tam locate` of a survey line with recorded positions: a list of targets, or the reason for none."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.io import netcdf_file
from scipy.spatial.transform import Rotation

from tam_calibration.cli.main import main
from tam_calibration.fit import calibrate
from tam_calibration.results import write_calibration
from tam_calibration.sources.dipole import dipole_field

EARTH_T = np.array([1.2e-6, 20.5e-6, -44e-6])
TIME_S = np.arange(600) / 10
PLACES_M = np.array([[15.0, 2.0, -4.0], [45.0, -3.0, -5.0]])
MOMENTS_AM2 = np.array([[300.0, 800.0, -600.0], [-100.0, 150.0, 90.0]])


@pytest.fixture(scope="module")
def folder(tmp_path_factory, recording, cross, true_errors):
    """Return a folder with a calibration, a line past two dipoles, and its first samples."""
    folder = tmp_path_factory.mktemp("line")
    write_calibration(folder / "c.yaml", calibrate(recording, cross))
    names = ["time_s", *(f"b{sensor}{axis}_T" for sensor in range(1, 5) for axis in "xyz")]
    names += ["qx", "qy", "qz", "qw", "x_m", "y_m", "z_m"]
    for file, aside in (("beside.csv", 4.0), ("line.csv", 0.0)):
        rows = passed(aside, cross, true_errors)
        np.savetxt(folder / file, rows, delimiter=",", header=",".join(names), comments="", fmt="%.15g")
    np.savetxt(folder / "short.csv", rows[:12], delimiter=",", header=",".join(names), comments="", fmt="%.15g")
    np.savetxt(folder / "bare.csv", rows[:, :-3], delimiter=",", header=",".join(names[:-3]), comments="", fmt="%.15g")
    return folder


def passed(aside_m, cross, true_errors):
    """Return the rows of a line past two dipoles."""
    turns = Rotation.from_euler("zyx", 0.08 * np.sin(np.outer(TIME_S, [0.9, 0.7, 1.1])))
    path = np.column_stack([TIME_S, aside_m + 0.1 * np.sin(TIME_S), np.zeros(600)])
    points = path[:, None] + np.einsum("nij,kj->nki", turns.as_matrix(), cross.positions_m)
    world = EARTH_T + sum(
        dipole_field(points - place, moment)[0] for place, moment in zip(PLACES_M, MOMENTS_AM2, strict=True)
    )
    fields = np.einsum("nji,nkj->nki", turns.as_matrix(), world)
    noise = 1e-9 * np.random.default_rng(3).normal(size=fields.shape)
    readings = true_errors.distort(fields) + noise
    return np.column_stack([TIME_S, readings.reshape(600, -1), turns.as_quat(), path])


def run(folder, name, *words):
    """Run the command."""
    return CliRunner().invoke(main, ["locate", str(folder / name), "--calibration", str(folder / "c.yaml"), *words])


def printed(folder, name, *words):
    """Return what the command prints, and its JSON."""
    result = run(folder, name, *words, "--json", str(folder / "answer.json"))
    assert result.exit_code == 0, result.stderr
    return " ".join(result.stdout.split()), json.loads((folder / "answer.json").read_text())


def test_targets_are_listed_with_their_errors(folder):
    """Both dipoles, in the world of the positions, within five standard errors."""
    words, answer = printed(folder, "line.csv", "--position-error-m", "0.01", "--position-drift-m", "0.02")
    assert words.startswith("2 targets along the line.")
    assert len(answer["targets"]) == 2 and answer["notes"] == []
    for target in answer["targets"]:
        away = np.abs(PLACES_M - target["position_m"]) / target["standard_error_m"]
        assert away.max(axis=1).min() < 5
        assert target["evidence"] > 0 and target["extended"] is False
        assert len(target["moment_A_m2"]) == 3


def test_a_platform_that_stays_draws_no_line(folder):
    """A velocity of zero is refused in one sentence."""
    line = ["locate", str(folder / "line.csv"), "--calibration", str(folder / "c.yaml"), "--velocity", "0,0,0"]
    result = CliRunner().invoke(main, line)
    assert result.exit_code == 2 and "--velocity is zero, and a platform that stays draws no line" in result.stderr


def test_the_answer_says_what_the_gyroscope_did(folder, tmp_path):
    """On the terminal and in the JSON: one with a long gap is not used."""
    lines = (folder / "line.csv").read_text().splitlines()[:251]
    rates = [",,," if 100 < number < 200 else ",0,0,0" for number in range(len(lines))]
    rates[0] = ",wx_rad_s,wy_rad_s,wz_rad_s"
    holed = tmp_path / "holed.csv"
    holed.write_text("\n".join(map("".join, zip(lines, rates, strict=True))))
    words, answer = printed(folder, holed)
    [note] = answer["notes"]
    assert "the angular velocity has gaps" in note and "the angular velocity has gaps" in words


@pytest.mark.parametrize("origin", [None, "54.0,10.0"])
def test_lines_beside_each_other_give_a_map(folder, tmp_path, origin):
    """As netCDF, with degrees where the origin is known; its largest contraction is near a dipole."""
    names, to = [tmp_path / "line.csv", tmp_path / "beside.csv"], tmp_path / "map.nc"
    for name in names:  # the part of the first dipole
        name.write_text("\n".join((folder / name.name).read_text().splitlines()[:251]))
    more = ["--origin", origin] if origin else []
    assert run(folder, names[0], str(names[1]), "--grid", str(to), *more).exit_code == 0
    with netcdf_file(to, mmap=False) as file:
        y, x = file.variables["contraction_nT_per_m"].dimensions
        steepest = np.nan_to_num(file.variables["contraction_nT_per_m"][:])
        anomaly = file.variables["anomaly_nT"][:]
        row, column = np.unravel_index(np.argmax(steepest), steepest.shape)
        place = [file.variables[x][column], file.variables[y][row]]
    assert np.nanmax(np.abs(anomaly)) > 100
    if origin:
        place = [(place[0] - 10) * 111320 * np.cos(np.radians(54)), (place[1] - 54) * 111320]
    assert np.linalg.norm(PLACES_M[0, :2] - place) < 4


def test_one_line_gives_no_map(folder, tmp_path):
    """Nothing is known beside it."""
    result = run(folder, "line.csv", "--grid", str(tmp_path / "map.nc"))
    assert result.exit_code == 2 and "lines beside each other" in result.stderr
    assert not (tmp_path / "map.nc").exists()


def test_a_refusal_has_a_reason_and_no_target(folder):
    """Exit code 1, and what to do."""
    result = run(folder, "short.csv", "--json")
    assert result.exit_code == 1
    answer = json.loads(result.stdout)
    assert answer["targets"] == [] and "too short" in answer["refused"]


@pytest.mark.parametrize(
    ("name", "words", "sentence"),
    [
        ("line.csv", ("--position-error-m", "-1"), "--position-error-m must be a finite number"),
        ("line.csv", ("--position-drift-m", "nan"), "--position-drift-m must be a finite number"),
        ("bare.csv", ("--position-drift-m", "0.1"), "those of positions, of which there are none"),
    ],
)
def test_errors_of_positions_are_checked(folder, name, words, sentence):
    """Exit code 2 and one sentence."""
    result = run(folder, name, *words)
    assert result.exit_code == 2
    assert sentence in result.stderr
