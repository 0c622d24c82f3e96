"""What sound sensors read is no fault, whatever the motion and whatever cause of the diagnosis is in it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tam_calibration.effects.library import effect_named
from tam_calibration.integrity.check import faults_of
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.recordings import read_array, read_recording
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate
from tam_validation.blind.case import make_case
from tam_validation.blind.case_plan import CasePlan
from tam_validation.blind.catalogue import CATALOGUE
from tam_validation.blind.outside import OUTSIDE

RECORDINGS = Path(__file__).parents[3] / "shared" / "data" / "recordings"


@pytest.mark.parametrize("path", sorted(RECORDINGS.glob("*.csv")), ids=lambda path: path.stem)
def test_real_recordings(path):
    """Phones in steps of 100 nT and more, and a tracked sensor, whose samples are held and interpolated."""
    array = read_array(RECORDINGS / ("broad.yaml" if path.stem.startswith("broad") else "phones.yaml"))
    assert faults_of(read_recording(path), array) == []


@pytest.mark.parametrize("name", ["wu_table_1", "wu_turntable", "tumble_100_hz", "auv", "warming_up"])
def test_scenarios(name):
    """Random attitudes, the regular ones of a turntable, a tumble, a vehicle that tilts little."""
    scenario = read_scenario(name)
    assert faults_of(simulate(scenario).recording, scenario.array) == []


def as_recording(case):
    """Return recording and array of a case of the check on withheld effects."""
    columns, given = case.columns, case.array
    count = sum(name.endswith("x_nT") for name in columns)
    readings = [[columns[f"b{sensor + 1}{axis}_nT"] for axis in "xyz"] for sensor in range(count)]
    attitude = np.column_stack([columns[name] for name in ("qx", "qy", "qz", "qw")]) if "qx" in columns else None
    scalar = 1e-9 * columns["scalar_nT"] if "scalar_nT" in columns else None
    recording = Recording(columns["time_s"], 1e-9 * np.moveaxis(readings, 2, 0), scalar, attitude=attitude)
    noise_T = 1e-9 * given["vector_noise_nT"]
    if "baseline_m" in given:
        return recording, Array.cross(given["baseline_m"], noise_T)
    return recording, Array(given["positions_m"], np.full(count, noise_T))


@pytest.mark.parametrize("cause", sorted({*CATALOGUE, *OUTSIDE}))
def test_causes_that_a_diagnosis_looks_for(cause):
    """None refuses a diagnosis, and only clipped and rounded readings refuse a calibration."""
    plan = CasePlan("single" if cause in CATALOGUE else "outside", (cause,), (10.0,))
    faults = faults_of(*as_recording(make_case(plan, seed=4, number=1)))
    allowed = effect_named(cause).shows_as if cause in ("saturation", "quantization") else ()
    assert {fault.name for fault in faults} <= set(allowed) and all(fault.may_be_effect for fault in faults)


@pytest.mark.parametrize("noise_T", [1e-9, 300e-9])
def test_an_array_at_rest(run, noise_T):
    """Noise alone has neither hand nor unit; nor have steps of a microtesla, in which nothing moves."""
    noise = noise_T * np.random.default_rng(1).normal(size=(1500, 4, 3))
    still = np.broadcast_to(run.recording.readings_T[:1], noise.shape)
    assert run.spoiled(lambda readings: readings.__setitem__(slice(None), still + noise)).told == []
    rounded = replace(run, array=Array(run.array.positions_m))
    assert rounded.spoiled(lambda readings: readings.__setitem__(slice(None), np.round(still + noise, 6))).told == []


def test_cube_orientations(run):
    """A sensor may be mounted in any of the 24 ways in which a right-handed one can lie along the axes."""
    from scipy.spatial.transform import Rotation

    for turn in Rotation.create_group("O").as_matrix():
        assert run.spoiled(lambda readings, turn=turn: turned(readings, 2, turn)).told == []


def turned(readings, sensor, turn):
    """Turn the axes of one sensor, numbered from 1."""
    readings[:, sensor - 1] = readings[:, sensor - 1] @ turn.T


def test_sensors_of_a_vehicle_may_all_be_turned_over(vehicle):
    """By half a turn about an axis: the attitude does not make that a mirror."""
    for turn in (np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1])):
        assert vehicle.spoiled(lambda readings, turn=turn: readings.__imatmul__(turn)).told == []


def test_a_channel_that_never_changes_is_noted(run):
    """It refuses nothing, and is no warning: the current may be off."""
    count = run.recording.sample_count
    still = run.of(1, 2, 3, 4, temperature_C=np.zeros(count), current_A=np.linspace(0, 1, count))
    [fault] = still.faults
    assert fault.severity == "note"
    assert fault.sentence == "the temperature is 0 °C in every sample: make sure that it is recorded at all"


def test_a_scalar_that_never_changes_is_noted(run):
    """It may be stuck; that it is read in every second sample alone does not hide that. A few readings may be equal."""
    scalar_T = np.full(run.recording.sample_count, 48e-6)
    scalar_T[::2] = np.nan
    [fault] = run.of(1, 2, 3, 4, scalar_T=scalar_T).faults
    assert fault.severity == "note"
    assert fault.sentence == "the scalar is 48000 nT in every sample: make sure that it is recorded at all"
    scalar_T[5:] = np.nan
    assert run.of(1, 2, 3, 4, scalar_T=scalar_T).told == []
