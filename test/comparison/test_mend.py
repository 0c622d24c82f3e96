"""What is copied into a simulator is well-formed and holds the numbers of the mend."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from mends import EFFECTS, fitted, mend_of, run_of

from tam_calibration.comparison.mend import NoiseTerm, gazebo_sdf, python_plugin
from tam_calibration.results.comparison_json import write_mend

BIAS_T = np.array([[3.0, -40.0, 5.0], [0.0, 1.0, 2.0], [7.0, 8.0, 9.0], [-1.0, -2.0, -3.0]]) * 1e-9


@pytest.fixture(scope="module")
def run():
    """Return a run with every channel."""
    return run_of(200)


@pytest.fixture(scope="module")
def mend(run):
    """Return a mend with steps, a range, a delay, and noise of each colour."""
    slow = NoiseTerm(1, "x", 2e-9, 1e-9, knee_hz=0.5, exponent=2.0)
    band = NoiseTerm(2, "y", 1e-9, 0.0, band_hz=(4.0, 5.0), band_T=1e-9)
    effects = [EFFECTS["quantization"], EFFECTS["saturation"], EFFECTS["time_skew"]]
    plain = mend_of(run, effects, [slow, band], ["hysteresis"])
    errors = replace(plain.calibration.errors, bias_T=BIAS_T)
    return replace(plain, calibration=replace(plain.calibration, errors=errors))


def sdf(mend):
    """Return the sensors of the SDF text, parsed."""
    return ElementTree.fromstring(f"<link>{gazebo_sdf(mend)}</link>").findall("sensor")


def number(element, path):
    """Return the number of an element's descendant."""
    return float(element.find(path).text)


def test_gazebo_gets_noise_and_bias_in_tesla(mend):
    """The deviation of a sample's white noise, not its variance, and the bias with its sign where none is drawn."""
    sensors = sdf(mend)
    assert [sensor.get("name") for sensor in sensors] == ["tam_1", "tam_2", "tam_3", "tam_4"]
    assert {sensor.get("type") for sensor in sensors} == {"magnetometer"}
    first = sensors[0].find("magnetometer")
    assert number(first, "x/noise/stddev") == 2e-9
    assert number(first, "y/noise/stddev") == 1e-9  # as the array states it
    assert number(first, "y/noise/mean") == pytest.approx(-40e-9)
    assert number(first, "y/noise/bias_mean") == 0
    assert number(first, "y/noise/bias_stddev") == pytest.approx(mend.calibration.standard_errors[0, 7], rel=1e-5)
    assert number(sensors[0], "update_rate") == 20


def test_gazebo_s_slow_noise_is_a_process_of_first_order(mend):
    """As its Gaussian noise model makes it, the density is that of the term where it stands out of white noise."""
    noise = sdf(mend)[0].find("magnetometer/x/noise")
    stddev, constant_s = (number(noise, f"dynamic_bias_{name}") for name in ("stddev", "correlation_time"))
    frequency = np.array([0.15, 0.25])
    density = 2 * stddev**2 * constant_s**2 / (1 + (2 * np.pi * frequency * constant_s) ** 2)
    expected = 2 * 2e-9**2 / 20 * (0.5 / frequency) ** 2
    assert density == pytest.approx(expected, rel=0.15)
    assert sdf(mend)[1].find("magnetometer/y/noise/dynamic_bias_stddev") is None


def test_gazebo_rounds_where_the_recording_does(mend):
    """A step is the precision of quantised noise; without one there is none."""
    noise = sdf(mend)[3].find("magnetometer/z/noise")
    assert noise.get("type") == "gaussian_quantized" and number(noise, "precision") == pytest.approx(60e-9)
    plain = sdf(replace(mend, added=()))[3].find("magnetometer/z/noise")
    assert plain.get("type") == "gaussian" and plain.find("precision") is None


def test_what_the_sdf_cannot_hold_is_told(mend):
    """Comments send the rest to the mend file, and say nothing of what the SDF holds."""
    text = gazebo_sdf(mend)
    assert "time_skew goes to the mend file" in text and "scale factors, non-orthogonality" in text
    assert "sensor 2, axis y: noise between 4 and 5 Hz" in text and "the simulation has hysteresis" in text
    assert "saturation goes" in text and "quantization goes" not in text and "slow noise" not in text


def test_the_plugin_s_lines_run(tmp_path, monkeypatch, run, mend):
    """They load the mend file and add to one sample."""
    monkeypatch.chdir(tmp_path)
    drift = fitted("bias_jump", {"time_s": -1.0}, 0, 0, "offset", {"offset": 1e-7})
    mend = replace(mend, added=(drift,), noise=())
    write_mend("mend.yaml", mend)
    names = {"readings_T": run.readings_T[0], "time_s": 0.0, "scalar_T": None}
    exec(python_plugin(mend), names)
    assert (names["readings_T"] - run.readings_T[0])[0, 0] == pytest.approx(1e-7)
    assert len([line for line in python_plugin(mend).splitlines() if line]) <= 5


def test_the_plugin_hands_on_the_channels_that_its_effects_follow(tmp_path, monkeypatch, run, mend):
    """A drift needs the temperature: the lines have it, and run."""
    monkeypatch.chdir(tmp_path)
    drift = fitted("temperature_drift", {"time_constant_s": 0.0, "reference_C": 20.0}, 0, 0, "offset", {"offset": 1e-8})
    mend = replace(mend, added=(drift,), noise=())
    write_mend("mend.yaml", mend)
    names = {"readings_T": run.readings_T[0], "time_s": 0.0, "scalar_T": None, "temperature_C": 30.0}
    exec(python_plugin(mend), names)
    assert (names["readings_T"] - run.readings_T[0])[0, 0] == pytest.approx(1e-7)
