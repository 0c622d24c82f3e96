"""Recordings that were not made by this project: phones, and an optically tracked sensor."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tam_calibration.comparison.mistakes import mistakes_of
from tam_calibration.fit import calibrate
from tam_calibration.model.exceptions import Refused
from tam_calibration.recordings import read_array, read_recording

SHARED = Path(__file__).parents[2] / "shared" / "data"
RECORDINGS = SHARED / "recordings"

pytestmark = pytest.mark.skipif(
    not RECORDINGS.is_dir(),
    reason=f"the recordings of phones and a tracked sensor are not part of the package, and not at {RECORDINGS}",
)


def table():
    """Return the rows of the nine-parameter table: name to RMS residual in nT, fitted by another program."""
    rows = [line.split("|") for line in (SHARED / "README.md").read_text().splitlines() if ".csv |" in line]
    return {row[1].strip(): float(row[4]) for row in rows if "broad_32" not in row[1]}


def fit(name):
    """Return the calibration of a recording by the default method."""
    array = "broad.yaml" if name.startswith("broad") else "phones.yaml"
    return calibrate(read_recording(RECORDINGS / name), read_array(RECORDINGS / array))


@pytest.mark.parametrize("name", table() if RECORDINGS.is_dir() else ["absent"])
def test_residual_is_that_of_the_best_ellipsoid(name):
    """The residual |U(m - b)| - F is within 1 % of, or below, the nine-parameter least-squares fit's."""
    assert fit(name).in_sample.sensor_intensity_T[0] * 1e9 <= 1.01 * table()[name]


def test_hard_iron_of_a_phone_repeats():
    """The bias of the Nexus 5 on three days agrees to 3 µT; the largest difference is 3.01 µT, of y on days 2 and 3."""
    biases = np.array([fit(f"nexus5_d{day}.csv").errors.bias_T[0] for day in (2, 3, 4)])
    assert np.ptp(biases, axis=0).max() < 3.05e-6


@pytest.mark.parametrize("method", ["maximum_likelihood", "robust", "lossless", "integrated"])
def test_a_magnet_attached_in_the_middle_is_refused_with_the_times(method):
    """The run with a magnet from 36 to 100 s is not one calibration: a quiet time and the loud middle are told."""
    recording, array = read_recording(RECORDINGS / "broad_32.csv"), read_array(RECORDINGS / "broad.yaml")
    with pytest.raises(Refused, match=r"not one calibration: .* nT between .* but .* between (36|52|68|84)\.\d and"):
        calibrate(recording, array, method)


@pytest.mark.parametrize(
    ("name", "unit", "kinds"),
    [("broad_08", 1.0, []), ("broad_33", 1.0, []), ("broad_08", 1e4, ["gauss_for_tesla"])],
)
def test_runs_of_one_sensor_have_no_gross_mistake_beside_each_other(name, unit, kinds):
    """Neither has another run, nor one with a magnet attached, where a simulator's are sought; gauss are one."""
    one, other = (read_recording(RECORDINGS / f"{each}.csv") for each in (name, "broad_02"))
    array = read_array(RECORDINGS / "broad.yaml")
    found = mistakes_of(replace(one, readings_T=unit * one.readings_T), other, array, array)
    assert [mistake.kind for mistake in found] == kinds
