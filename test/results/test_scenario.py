"""Scenario files and the truth beside a simulated recording."""

from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.linalg import norm
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from tam_calibration.model.array import TENSOR_OUTPUTS
from tam_calibration.model.exceptions import InputError
from tam_calibration.results.scenario import read_scenario, shipped_scenarios, write_truth
from tam_calibration.simulation import simulate

BOULDER = Path(__file__).parents[3] / "shared" / "data" / "usgs_boulder"

PLAIN = """\
array: {baseline_m: 0.5, vector_noise_nT: 1.0}
site: {intensity_nT: 50000, inclination_deg: 60}
motion: {kind: random}
samples: 20
rate_hz: 10
"""


@pytest.fixture
def read(tmp_path):
    """Return a function that reads a scenario from a text."""

    def read_text(text):
        path = tmp_path / "mine.yaml"
        path.write_text(text)
        return read_scenario(path)

    return read_text


@pytest.mark.parametrize("name", ["wu_table_1", "wu_turntable", "tumble_100_hz", "auv", "warming_up"])
def test_shipped_scenarios_can_be_named(name):
    """Every shipped scenario is found by its name and makes a recording of plausible readings."""
    assert name in shipped_scenarios()
    made = simulate(replace(read_scenario(name), sample_count=50))
    made.recording.check_plausible()


def residuals_before_calibration(made):
    """Return the four intensity and the tensor residuals of the raw readings, nT and nT/m (Wu 2025 eqs. 14, 16)."""
    readings, array = made.recording.readings_T, made.scenario.array
    true = norm(made.center_field_T, axis=1)[:, None]
    intensity = np.sqrt(((norm(readings, axis=2) - true) ** 2).mean(axis=0))
    tensor = (readings.reshape(len(readings), -1) @ array.operator.T)[:, TENSOR_OUTPUTS]
    return np.array([*intensity, norm(np.sqrt((tensor**2).mean(axis=0)))]) * 1e9


def test_wu_table_1_gives_his_residuals_before_calibration():
    """Fig. 5: 1035, 1333, 762, 1684 nT and 8172 nT/m, the mean of 50 runs."""
    scenario = read_scenario("wu_table_1")
    assert scenario.sample_count == 360
    runs = [residuals_before_calibration(simulate(replace(scenario, seed=seed))) for seed in range(50)]
    assert_allclose(np.mean(runs, axis=0), [1035, 1333, 762, 1684, 8172], rtol=0.02)


def test_wu_turntable_has_his_poses_and_drift():
    """Section 4.2: 72 different poses of 20 s, 52 185.0 nT that drifts by 8.26 nT, baseline 0.21 m."""
    made = simulate(read_scenario("wu_turntable"))
    assert len(np.unique(made.attitude.round(9), axis=0)) == 72
    assert_allclose(made.recording.time_s[-1], 71 * 20)
    intensity = norm(made.center_field_T, axis=1)
    assert_allclose([intensity.mean(), intensity.std()], [52185.0e-9, 8.26e-9], rtol=1e-6)
    assert_allclose(made.scenario.array.positions_m[0], [0.105, 0, 0])


def test_auv_keeps_its_limits_and_has_every_channel():
    """Pitch and roll stay within 30°, the scalar is slower, and all channels are recorded."""
    made = simulate(read_scenario("auv"))
    _, pitch, roll = Rotation.from_quat(made.attitude).as_euler("ZYX", degrees=True).T
    assert 29 < np.abs(pitch).max() <= 30 + 1e-9 and 29 < np.abs(roll).max() <= 30 + 1e-9
    recording = made.recording
    assert np.isfinite(recording.scalar_T).sum() == recording.sample_count / 2
    assert all(channel is not None for channel in (recording.temperature_C, recording.current_A, recording.attitude))


def test_units_of_the_file(read):
    """Nanotesla and degrees of the file are tesla and radians of the scenario."""
    sensors = "".join(
        f"  - {{sensor: {n}, scale_factor: [1, 2, 3], bias_nT: [10, 20, 30], misalignment_deg: [1, 2, 3]}}\n"
        for n in (1, 2, 3, 4)
    )
    scenario = read(f"{PLAIN}sensors:\n{sensors}")
    assert_allclose(scenario.errors.bias_T[3], [10e-9, 20e-9, 30e-9])
    assert_allclose(scenario.errors.misalignment[0], np.radians([1, 2, 3]))
    assert_array_equal(scenario.errors.non_orthogonality, 0)
    assert_allclose(scenario.array.vector_noise_T, 1e-9)
    assert_allclose(scenario.site_field_T, [0, 25e-6, -50e-6 * np.sqrt(3) / 2])


def test_further_channels_are_switched_between_two_levels(read):
    """Each in its own unit; an effect that follows one is added, and one that follows another is refused by name."""
    rudder = "further_channels: {actuator_rudder: {low: -0.2, high: 0.2, period_s: 2}}\n"
    effect = (
        "effects:\n- effect: platform_field\n  terms:\n"
        "  - {sensor: 1, term: actuator_rudder, values: {actuator_rudder x: 50 nT}}\n"
    )
    scenario = read(PLAIN + rudder + effect)
    still = simulate(replace(scenario, effects=())).recording
    recording = simulate(scenario).recording
    angle = recording.further["actuator_rudder"]
    assert set(angle) <= {-0.2, 0.2}
    assert_allclose((recording.readings_T - still.readings_T)[:, 0, 0], 50e-9 * angle, atol=1e-18)
    with pytest.raises(InputError, match="follows actuator_rudder: add it to further_channels"):
        simulate(read(PLAIN + effect))


def test_what_a_scenario_does_not_name_is_not_simulated(read):
    """Without sensors they are perfect; without channels there are none."""
    scenario = read(PLAIN)
    assert_array_equal(scenario.errors.matrix, np.tile(np.eye(3), (4, 1, 1)))
    assert scenario.drift is scenario.dipole is scenario.scalar is scenario.current is scenario.attitude is None


@pytest.mark.parametrize(
    "motion",
    [
        "{kind: random_euler_angles}",
        "{kind: three_axis_turns}",
        "{kind: turntable}",
        "{kind: tumble}",
        "{kind: auv, pitch_limit_deg: 20, roll_limit_deg: 10, turn_period_s: 30}",
    ],
)
def test_every_motion_can_be_asked_for(read, motion):
    """Each kind of motion makes a recording."""
    assert simulate(read(PLAIN.replace("{kind: random}", motion))).recording.sample_count == 20


def test_a_site_may_have_a_gradient(read):
    """The gradient is read in nT/m, and a scalar magnetometer away from the centre feels it."""
    rows = "[[120, -80, 60], [-80, -200, 90], [60, 90, 80]]"
    text = PLAIN.replace("baseline_m: 0.5", "baseline_m: 0.5, scalar_position_m: [0, 0, 1]")
    scenario = read(f"{text}site_gradient_nT_per_m: {rows}\nscalar: {{}}\n")
    assert_allclose(scenario.site_gradient_T_per_m * 1e9, yaml.safe_load(rows))
    made = simulate(scenario)
    assert np.ptp(made.recording.scalar_T) > 50e-9
    with pytest.raises(InputError, match="must be symmetric"):
        read(f"{PLAIN}site_gradient_nT_per_m: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n")


def test_a_dipole_can_be_asked_for(read):
    """With a dipole the true gradient is not zero."""
    made = simulate(read(f"{PLAIN}dipole: {{position_m: [5, 0, -1], moment_Am2: [0, 0, 100]}}\n"))
    assert (norm(made.gradient_T_per_m, axis=(1, 2)) > 1e-9).all()


def test_place_and_date_give_the_geomagnetic_field(read):
    """The site may be a place: the field is then IGRF's."""
    text = PLAIN.replace(
        "site: {intensity_nT: 50000, inclination_deg: 60}",
        "place: {latitude_deg: 40.137, longitude_deg: -105.237, height_m: 1682, date: 2016-01-15}",
    )
    assert_allclose(norm(read(text).site_field_T), 52.3e-6, rtol=3e-3)


def test_an_observatory_can_give_the_drift(read, tmp_path):
    """The site's field varies as the file beside the scenario says, from the start that is asked for."""
    rows = [f"{datetime(2016, 1, 1) + timedelta(seconds=n)}.000 001 20000.0 0.0 {40000 + n}.0" for n in range(60)]
    header = " Format IAGA-2002 |\nDATE TIME DOY TSTH TSTE TSTZ |\n"
    (tmp_path / "tst.sec").write_text(header + "\n".join(rows) + "\n")
    drift = "drift: {kind: observatory, file: tst.sec, start: 2016-01-01T00:00:30Z}\n"
    made = simulate(read(PLAIN + drift))
    down = -Rotation.from_quat(made.attitude).apply(made.center_field_T)[:, 2]
    assert_allclose(np.diff(down), 0.1e-9, rtol=1e-3)
    with pytest.raises(InputError, match="gap within the 2 s"):
        simulate(read(PLAIN + drift.replace("00:30Z", "00:59Z")))


def test_a_real_observatory_gives_the_drift_of_a_simulated_site(read):
    """An hour of Boulder makes the intensity vary by a few nT, and the scalar magnetometer follows."""
    path = BOULDER / "BOU201601vmin.min"
    if not path.exists():
        pytest.skip(f"the observatory's file is not at {path}")
    drift = f"drift: {{kind: observatory, file: {path}, start: 2016-01-05T18:00:00}}\nscalar: {{}}\n"
    recording = simulate(read(PLAIN.replace("rate_hz: 10", "rate_hz: 0.00555") + drift)).recording
    assert 0.5e-9 < recording.scalar_T.std() < 20e-9


def test_truth_is_written_in_the_units_of_files(tmp_path):
    """The file beside the recording states the errors as the scenario did, and the true intensity."""
    made = simulate(read_scenario("wu_table_1"))
    write_truth(tmp_path / "run.truth.yaml", made)
    truth = yaml.safe_load((tmp_path / "run.truth.yaml").read_text())
    stated = yaml.safe_load(shipped_scenarios()["wu_table_1"].read_text())
    for block, given in zip(truth["sensors"], stated["sensors"], strict=True):
        assert given.items() <= {key: value for key, value in block.items() if key != "matrix"}.items()
    assert_allclose(truth["sensors"][2]["matrix"], made.errors.matrix[2], rtol=0)
    assert_allclose(truth["field"]["intensity_nT"], 54955.83)
    assert truth["seed"] == 1


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (("samples: 20", "samples: 20\nsample: 20"), "the key 'sample' is not known; known are array, sensors, site"),
        (("intensity_nT", "intensity_uT"), "the key 'site.intensity_(uT' is not known|nT' is missing)"),
        (("baseline_m", "basline_m"), "the key 'array.basline_m' is not known"),
        (("samples: 20\n", ""), "the key 'samples' is missing"),
        (("samples: 20", "samples: 0"), "at least one sample, not 0"),
        (("samples: 20", "samples: many"), "samples: input should be a valid integer"),
        (("rate_hz: 10", "rate_hz: -1"), "rate_hz: input should be greater than 0"),
        (("kind: random", "kind: dance"), "motion: .*'dance'"),
        (("kind: random", "kind: random, turn_rate_deg_per_s: 4"), "turn_rate_deg_per_s' is not known"),
        (("kind: random", "kind: auv, pitch_limit_deg: 95, roll_limit_deg: 0, turn_period_s: 9"), "less than 90"),
        (("intensity_nT: 50000", "intensity_nT: -5"), "site.intensity_nT: input should be greater than 0"),
        (("site: {intensity_nT: 50000, inclination_deg: 60}\n", ""), "give either site .* or place"),
        (("samples: 20", "samples: 20\nsensors: [{sensor: 2}]"), "sensors must be numbered 1, 2"),
        (("samples: 20", "samples: 20\nsensors: [{sensor: 1}]"), "errors of 1 sensors and an array of 4"),
        (("samples: 20", "samples: 20\nsensors: [{sensor: 1, bias: [0, 0, 0]}]"), "'sensors.1.bias' is not known"),
        (("samples: 20", "samples: 20\ndrift: {kind: sinusoid, period_s: 9}"), "standard_deviation_nT' is missing"),
        (("samples: 20", "samples: 20\ndrift: {kind: observatory, file: none.min}"), "none.min cannot be read"),
        (("samples: 20", "samples: [20"), "not YAML at line"),
    ],
)
def test_typing_errors_are_named(read, change, sentence):
    """One sentence names the file, the key and what is wrong with it."""
    assert change[0] in PLAIN
    with pytest.raises(InputError, match=rf"mine.yaml: .*{sentence}"):
        read(PLAIN.replace(*change))


def test_an_unknown_name_lists_the_shipped_scenarios():
    """A scenario that is neither a file nor shipped is answered with the names that are."""
    shipped = r"no file wu_table_2, and no scenario .* auv, tumble_100_hz, warming_up, wu_table_1"
    with pytest.raises(InputError, match=shipped):
        read_scenario("wu_table_2")
