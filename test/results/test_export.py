"""Each exported file, read and applied as its consumer does, corrects as the calibration; the loss is as stated."""

import ctypes
import json
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
import yaml
from numpy.linalg import norm
from numpy.testing import assert_allclose
from scipy.linalg import polar

from tam_calibration.correction.parts import EffectSize
from tam_calibration.fit import calibrate
from tam_calibration.model.fitted_effect import Contribution, FittedEffect
from tam_calibration.model.sensor_errors import ORIENTATIONS, SensorErrors
from tam_calibration.results.export import CONSUMERS, export

GAUSS_T = 1e-4
MILLIGAUSS_T = 1e-7
ROUNDING_T = 1e-11
"""Rounding of the parameters of an autopilot, floats of 32 bits, in a field of 50 µT; tesla."""


@pytest.fixture(scope="module")
def calibration(recording, cross):
    """Return a calibration of four sensors with errors of all kinds."""
    return calibrate(recording, cross)


def with_errors(calibration, number, matrix, bias_T=(0.0, 0.0, 0.0)):
    """Return a calibration whose sensor has another matrix, from the field to the readings, and bias."""
    matrices, biases = calibration.errors.matrix.copy(), calibration.errors.bias_T.copy()
    matrices[number - 1], biases[number - 1] = matrix, bias_T
    return replace(calibration, errors=SensorErrors.from_matrix(matrices, biases))


def fields(calibration, count=20_000):
    """Return fields (N, 3) of the intensity of a calibration in all directions."""
    directions = np.random.default_rng(3).normal(size=(count, 3))
    return calibration.intensity_T * directions / norm(directions, axis=1, keepdims=True)


def symmetric(diagonal, off_diagonal):
    """Return the matrix of three diagonal and three off-diagonal elements as PX4 and ArduPilot lay it out."""
    (xx, yy, zz), (xy, xz, yz) = diagonal, off_diagonal
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def parameters_of_qgroundcontrol(text):
    """Return a parameter file as `ParameterManager::readParametersFromStream` reads it, numbers as floats."""
    rows = [line.split("\t") for line in text.splitlines() if not line.startswith("#")]
    assert {(vehicle, component, kind) for vehicle, component, _, _, kind in rows} == {("1", "1", "9")}
    return {name: float(np.float32(value)) for _, _, name, value, _ in rows}


def px4(text, ignored=False):
    """Return the corrections of PX4's `Magnetometer::Correct`; if asked, without what its setters ignore at first."""
    found = parameters_of_qgroundcontrol(text)
    corrections = []
    for number in range(4):
        offset, scale, off_diagonal = (
            np.array([found[f"CAL_MAG{number}_{axis}{part}"] for axis in "XYZ"]) for part in ("OFF", "SCALE", "ODIAG")
        )
        if ignored:
            offset = offset if norm(offset) > 0.01 else np.zeros(3)
            scale = scale if norm(scale - 1) > 0.01 else np.ones(3)
            off_diagonal = off_diagonal if norm(off_diagonal) > 0.01 else np.zeros(3)
        matrix = symmetric(scale, off_diagonal)
        corrections.append(lambda raw, m=matrix, o=offset: (raw / GAUSS_T - o) @ m.T * GAUSS_T)
    return corrections


def parameters_of_ardupilot(text):
    """Return a parameter file as MAVProxy and Mission Planner read it."""
    lines = [line.split("#")[0].replace(",", " ").split() for line in text.splitlines()]
    return {name: float(value) for name, value in filter(None, lines)}


def ardupilot(text):
    """Return the corrections of ArduPilot's `AP_Compass_Backend::correct_field`."""
    found = parameters_of_ardupilot(text)
    corrections = []
    for number in ("", "2", "3"):
        offset, diagonal, off_diagonal = (
            np.array([found[f"COMPASS_{part}{number}_{axis}"] for axis in "XYZ"]) for part in ("OFS", "DIA", "ODI")
        )
        scale = found[f"COMPASS_SCALE{number}"]
        matrix = symmetric(diagonal, off_diagonal) * (scale if 1 / 1.5 <= scale <= 1.5 else 1)
        corrections.append(lambda raw, m=matrix, o=offset: (raw / MILLIGAUSS_T + o) @ m.T * MILLIGAUSS_T)
    return corrections


def imu_tools(*texts):
    """Return the corrections of `ImuFilterMadgwickRos::imuMagCallback`, which reads tesla."""
    biases = [yaml.safe_load(text)["/**"]["ros__parameters"] for text in texts]
    assert all(isinstance(value, float) for bias in biases for value in bias.values())
    return [lambda raw, b=bias: raw - [b["mag_bias_x"], b["mag_bias_y"], b["mag_bias_z"]] for bias in biases]


def microstrain(*texts):
    """Return the corrections that `microstrain-mag-cal-apply` sends to devices, as their manual defines them."""
    corrections = []
    for fit in map(json.loads, texts):
        assert fit["error"] == "NONE"
        matrix = np.array([[fit["softIronMatrix"][row + column] for column in "xyz"] for row in "xyz"])
        offset = np.array([fit["hardIronOffset"][axis] for axis in "xyz"])
        corrections.append(lambda raw, m=matrix, o=offset: (raw / GAUSS_T - o) @ m.T * GAUSS_T)
    return corrections


def in_si(text):
    """Return the corrections of the JSON."""
    sensors = [(np.array(each["correction_matrix"]), np.array(each["bias_T"])) for each in json.loads(text)["sensors"]]
    return [lambda raw, m=matrix, o=bias: (raw - o) @ m.T for matrix, bias in sensors]


def corrected(corrections, calibration, readings_T):
    """Return the fields (N, K, 3) of readings, sensor by sensor."""
    return np.stack([correct(readings_T[:, k]) for k, correct in enumerate(corrections)], axis=1)


def test_microstrain_and_json_correct_exactly(calibration, recording):
    """Their matrices are not symmetric: field and tensor are those of the calibration, without any loss."""
    outputs = calibration.apply(recording.readings_T)
    for target, read in (("microstrain", microstrain), ("json", in_si)):
        exported = export(calibration, target)
        field = corrected(read(*exported.texts), calibration, recording.readings_T)
        assert_allclose(field.reshape(len(field), -1) @ calibration.array.operator.T, outputs, rtol=0, atol=1e-18)
        assert exported.losses == ()


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
def test_the_header_corrects_in_c(calibration, recording, tmp_path):
    """Compiled without a warning, its arrays and its formula give the field, to the rounding of a float."""
    (text,) = export(calibration, "c").texts
    (tmp_path / "tam.h").write_text(text)
    assert re.search(
        r"field\[i\] = sum over j of tam_matrix\[k\]\[i\]\[j\] \* \(reading\[j\] - tam_bias_nT\[k\]\[j\]\)", text
    )
    (tmp_path / "tam.c").write_text(
        """#include "tam.h"
        void correct(int k, const float *reading, float *field) {
            for (int i = 0; i < 3; i++) {
                field[i] = 0;
                for (int j = 0; j < 3; j++) field[i] += tam_matrix[k][i][j] * (reading[j] - tam_bias_nT[k][j]);
            }
        }"""
    )
    library = tmp_path / "tam.so"
    subprocess.run(["cc", "-Wall", "-Werror", "-shared", "-fPIC", tmp_path / "tam.c", "-o", library], check=True)
    field = (ctypes.c_float * 3)()
    for readings_T in recording.readings_T[:20]:
        expected = calibration.errors.restore(readings_T[None])[0]
        for k in range(4):
            ctypes.CDLL(library).correct(k, (ctypes.c_float * 3)(*(1e9 * readings_T[k])), field)
            assert_allclose(np.array(field) * 1e-9, expected[k], rtol=0, atol=2e-11)


@pytest.mark.parametrize(("target", "read", "count"), [("px4", px4, 4), ("ardupilot", ardupilot, 3)])
def test_autopilots_give_the_field_but_for_a_rotation(calibration, recording, target, read, count):
    """Turned by the rotation of each matrix' polar decomposition it is the calibrated field; |B| needs no turn."""
    (text,) = export(calibration, target).texts
    field = corrected(read(text), calibration, recording.readings_T)
    expected = calibration.errors.restore(recording.readings_T)[:, :count]
    assert_allclose(norm(field, axis=2), norm(expected, axis=2), rtol=0, atol=ROUNDING_T)
    for k in range(count):
        rotation, _ = polar(np.linalg.inv(calibration.errors.matrix[k]))
        assert_allclose(field[:, k] @ rotation.T, expected[:, k], rtol=0, atol=ROUNDING_T)


def test_imu_tools_subtracts_the_bias(calibration, recording):
    """In tesla, to the last bits."""
    texts = export(calibration, "imu_tools").texts
    field = corrected(imu_tools(*texts), calibration, recording.readings_T)
    assert_allclose(field, recording.readings_T - calibration.errors.bias_T, rtol=0, atol=1e-19)


def test_ardupilot_files_are_read_by_pymavlink(calibration, tmp_path):
    """Its reader finds the same parameters."""
    mavparm = pytest.importorskip("pymavlink.mavparm")
    (text,) = export(calibration, "ardupilot").texts
    (tmp_path / "c.param").write_text(text)
    found = mavparm.MAVParmDict()
    assert found.load(str(tmp_path / "c.param")) and dict(found) == parameters_of_ardupilot(text)


def worst(correct, calibration, number):
    """Return the largest error of the field of a sensor in any direction, tesla, corrected by a consumer."""
    true = fields(calibration)
    raw = calibration.errors.distort(true)[:, number - 1]
    return norm(correct(raw) - true, axis=1).max()


def sizes(exported, number):
    """Return the losses of a sensor, each said to the hundredth of a nT."""
    losses = [loss for loss in exported.losses if loss.sentence.startswith(f"sensor {number}: ")]
    assert all(f"up to {1e9 * loss.size_T:.2f} nT" in loss.sentence for loss in losses)
    return losses


@pytest.mark.parametrize(
    ("target", "read", "words"),
    [
        ("px4", px4, "rotation of "),
        ("ardupilot", ardupilot, "rotation of "),
        ("imu_tools", imu_tools, "scale factors, non-orthogonality and rotation are left out"),
    ],
)
@pytest.mark.parametrize("number", [1, 2, 3])
def test_the_size_of_a_loss_is_the_largest_error_of_the_field(calibration, target, read, words, number):
    """Over 20 000 directions: no error is larger, and one comes within a thousandth."""
    exported = export(calibration, target)
    loss = sizes(exported, number)[0]
    error = worst(read(*exported.texts)[number - 1], calibration, number)
    assert words in loss.sentence
    assert 0.999 * loss.size_T - ROUNDING_T < error < loss.size_T + ROUNDING_T


def test_a_sensor_that_is_mounted_otherwise_loses_its_whole_turn(calibration):
    """A quarter turn is said in degrees, and makes the field wrong by its length times the square root of two."""
    quarter = ORIENTATIONS[np.flatnonzero(np.trace(ORIENTATIONS, axis1=1, axis2=2) == 1)[0]]
    (loss,) = sizes(export(with_errors(calibration, 2, 1.1 * quarter), "ardupilot"), 2)
    assert "a rotation of 90.000 deg is left out" in loss.sentence
    assert loss.size_T == pytest.approx(np.sqrt(2) * calibration.intensity_T)


def test_sensors_that_a_consumer_has_no_room_for_stay_uncorrected(calibration):
    """ArduPilot reads three: what is said of the fourth bounds the error of its raw readings."""
    exported = export(calibration, "ardupilot")
    (loss,) = sizes(exported, 4)
    assert "ardupilot reads only 3 sensors" in loss.sentence
    assert 0.7 * loss.size_T < worst(lambda raw: raw, calibration, 4) <= loss.size_T


IGNORED = {
    "off-diagonals of at most 0.01": ([0.9, 1.0, 1.1], [0.005, -0.004, 0.003], [3e-6, 0, 0]),
    "scales within 0.01 of 1": ([0.995, 1.002, 1.004], [0.02, 0.0, -0.01], [3e-6, 0, 0]),
    "offsets of at most 0.01 gauss": ([0.9, 1.0, 1.1], [0.02, 0.0, -0.01], [4e-7, -5e-7, 6e-7]),
}


@pytest.mark.parametrize("part", IGNORED)
def test_what_px4_ignores_is_said_with_its_size(calibration, part):
    """PX4 starts from no correction and takes over changes beyond 0.01 only; the file holds them all the same."""
    diagonal, off_diagonal, bias_T = IGNORED[part]
    small = with_errors(calibration, 1, np.linalg.inv(symmetric(diagonal, off_diagonal)), bias_T)
    exported = export(small, "px4")
    (loss,) = sizes(exported, 1)
    assert f"PX4 ignores {part}" in loss.sentence
    assert worst(px4(*exported.texts)[0], small, 1) < ROUNDING_T
    error = worst(px4(*exported.texts, ignored=True)[0], small, 1)
    assert 0.999 * loss.size_T < error < loss.size_T + ROUNDING_T


def test_scales_beyond_the_range_of_px4_are_limited(calibration):
    """To 3, as the size says."""
    far = with_errors(calibration, 1, np.diag([1 / 3.5, 1.0, 0.8]), [3e-6, 0, 0])
    exported = export(far, "px4")
    assert parameters_of_qgroundcontrol(*exported.texts)["CAL_MAG0_XSCALE"] == 3.0
    (loss,) = [loss for loss in sizes(exported, 1) if "limited to between 0.1 and 3.0" in loss.sentence]
    assert 0.999 * loss.size_T < worst(px4(*exported.texts)[0], far, 1) < loss.size_T + ROUNDING_T


@pytest.mark.parametrize("target", CONSUMERS)
def test_losses_and_effects_are_said_in_the_files_too(calibration, target):
    """No consumer removes an effect: its RMS is that of the field at the centre. MicroStrain's JSON has no comments."""
    offset = Contribution(1, 0, "offset", {"offset": 1e-9}, {"offset": 1e-11})
    effect = FittedEffect("temperature_drift", {"time constant": 60.0}, (offset,), {"time constant": 5.0})
    size = EffectSize(np.array([3e-9, 0, 4e-9, *np.zeros(6)]), np.zeros(9))
    exported = export(replace(calibration, effects=(effect,), effect_sizes=(size,)), target)
    assert exported.losses[0].sentence == "the effect temperature_drift is left out, 5.00 nT RMS"
    assert exported.losses[0].size_T == pytest.approx(5e-9)
    if target != "microstrain":
        assert all(loss.sentence in text for text in exported.texts for loss in exported.losses)
