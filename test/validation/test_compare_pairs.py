"""Pairs of a simulation from MuJoCo and a recording of another physics hold what their keys say, and are scored so."""

from dataclasses import replace

import numpy as np
import pytest
from pairs.folder import KEY, begin, open_key, pair_name, seal, write_pair
from pairs.making import TIMES, make_pair
from pairs.mistakes import mistaken_columns, mistaken_run, mistaken_vehicle
from pairs.noise import band, pink
from pairs.outcome import PairOutcome
from pairs.plan import MISTAKES, SHARES, PairPlan, plan_pairs
from pairs.run import run_of
from vehicle import VehicleRun

from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.sensor_errors import SensorErrors

pytest.importorskip("mujoco", reason="MuJoCo is not installed: .venv/bin/pip install -e '.[compare]'")

TURNS = [(0, "qx"), (1, "qy"), (2, "qz"), (3, "qw")]
FIELDS = [f"b{sensor}{axis}_nT" for sensor in range(1, 5) for axis in "xyz"]


@pytest.fixture(scope="module")
def drifting():
    """Return a pair whose recording has a bias that jumps and whose simulation has none."""
    return make_pair(PairPlan("missing", missing=("bias_jump",), gaps=(3.0,)), seed=1, number=1)


def test_the_kinds_are_shared_as_asked():
    """Of 200 pairs and 40 beside them each kind has its number, in an order that the seed draws."""
    plans = plan_pairs(200, seed=1, with_world=False)
    assert {kind: sum(plan.kind == kind for plan in plans) for kind in SHARES} == SHARES
    assert len(plans) == 240 and {plan.detail for plan in plans if plan.kind == "mistake"} == {*MISTAKES}
    assert plans != plan_pairs(200, seed=2, with_world=False)


def test_a_seed_stands_for_one_pair(drifting):
    """The same seed and number give the same tables; another number gives others."""
    again, other = (make_pair(PairPlan("missing", ("bias_jump",), gaps=(3.0,)), 1, number) for number in (1, 2))
    for name in FIELDS:
        np.testing.assert_array_equal(again.recording[name], drifting.recording[name])
    assert again.key == drifting.key and other.key != drifting.key


def test_the_mended_simulation_differs_by_the_effect_alone(drifting):
    """Its maker adds the recording's steps, at the sensor of the key, and nothing else."""
    sensor = drifting.key["missing"][0]["sensors"][0]
    for name in FIELDS:
        change = drifting.mended[name] - drifting.simulation[name]
        assert np.ptp(change) < 1e-9 or str(sensor) == name[1] or drifting.key["missing"][0]["parameters"]["magnet"]
    assert max(np.ptp(drifting.mended[name] - drifting.simulation[name]) for name in FIELDS) > 0


def test_the_noise_of_the_simulation_is_that_of_its_sheet():
    """What MuJoCo records beside what the scene around it says is white noise of the stated level."""
    key = make_pair(PairPlan("none"), seed=1, number=3).key
    levels = np.array(key["noise_nT"]["simulation"])[:12]
    assert np.ptp(levels) < 0.2 * levels.mean()
    np.testing.assert_allclose(levels.mean(), np.mean(key["noise_nT"]["recording"][:12]), rtol=0.03)


def test_other_parameters_are_one_effect_of_two_sizes():
    """Both sides have it at one place, the recording two and a half times as large."""
    key = make_pair(PairPlan("other", ("time_skew",), ("time_skew",), (3.0,)), seed=1, number=4).key
    (there,), (here,) = key["missing"], key["surplus"]
    assert (there["sensors"], there["axes"]) == (here["sensors"], here["axes"])
    assert there["amplitude"] == pytest.approx(2.5 * here["amplitude"]) and TIMES == 2.5


def test_every_mistake_changes_the_simulation():
    """Each is made in what is simulated, in its noise or in what is written, and by its own rule."""
    rng, vehicle = np.random.default_rng(1), VehicleRun(seed=1, sample_count=1000)
    assert mistaken_vehicle(rng, vehicle, "no_world_field").field_T.tolist() == [0, 0, 0]
    east, north, up = vehicle.field_T
    assert mistaken_vehicle(rng, vehicle, "ned_for_enu").field_T.tolist() == [north, east, -up]
    assert mistaken_vehicle(rng, vehicle, "wrong_hemisphere").field_T.tolist() == [east, north, -up]
    squares = {mistaken_vehicle(rng, vehicle, "variance_for_deviation").vector_noise_T for _ in range(20)}
    np.testing.assert_allclose(sorted(squares), [1e-18, 1e-14, 1e-12])
    columns = dict.fromkeys(["time_s", *FIELDS, "scalar_nT"], np.ones(3)) | {name: np.full(3, i) for i, name in TURNS}
    written = {name: mistaken_columns(rng, columns, name) for name in MISTAKES}
    assert written["gauss_for_tesla"]["b2y_nT"][0] == written["gauss_for_tesla"]["scalar_nT"][0] == 1e4
    assert written["microtesla_for_tesla"]["b4z_nT"][0] == 1e6
    assert [written["frd_for_flu"][f"b3{axis}_nT"][0] for axis in "xyz"] == [1, -1, -1]
    assert sum(written["mirrored_axis"][name][0] for name in FIELDS) == 10
    assert [written["attitude_wxyz"][name][0] for _, name in TURNS] == [3, 0, 1, 2]
    run = run_of(rng, replace(vehicle, temperature=None, current=None, errors=SensorErrors.none(4)))
    alike = mistaken_run(rng, run, "same_noise_in_channels").noise[0]
    assert (alike[:, 1:] == alike[:, :1]).all()
    again = mistaken_run(rng, run, "same_noise_again").noise[0]
    assert any((again[lag:] == again[:-lag]).all() for lag in range(200, 700))


def test_colours():
    """The density of pink noise falls by ten over a decade; a quarter of the spectrum holds the most of a band."""
    rng = np.random.default_rng(1)
    power = (np.abs(np.fft.rfft(pink(rng, (4096, 12)), axis=0)) ** 2).mean(axis=1)
    assert power[10:20].mean() / power[100:200].mean() == pytest.approx(10, rel=0.2)
    power = (np.abs(np.fft.rfft(band(rng, (4096, 12)), axis=0)) ** 2).mean(axis=1)
    assert np.sort(power)[-len(power) // 4 :].sum() > 0.8 * power.sum()


def test_a_key_that_was_altered_is_refused(tmp_path, drifting):
    """The key opens as it was sealed, and not otherwise; a set goes on only as it was begun."""
    begin(tmp_path, {"seed": 1})
    write_pair(tmp_path, pair_name(1), drifting)
    seal(tmp_path, [pair_name(1)])
    assert open_key(tmp_path)["pair_001"]["kind"] == "missing"
    (tmp_path / KEY).write_text((tmp_path / KEY).read_text().replace("bias_jump", "time_skew"))
    with pytest.raises(Refused, match="altered"):
        open_key(tmp_path)
    with pytest.raises(InputError, match="made otherwise"):
        begin(tmp_path, {"seed": 2})


TRUTH = {"effect": "time_skew", "sensors": [2], "axes": ["x"], "visible_gap": 1.0, "samples_changed": 9}
KEYS = {"kind": "missing", "detail": "", "gap": 1.0, "missing": [TRUTH], "surplus": []}


@pytest.mark.parametrize(
    ("changed", "side", "is_found", "is_wrong"),
    [
        ({}, "missing", True, False),
        ({"effect": "eddy_current"}, "missing", True, False),
        ({"sensors": [3]}, "missing", False, False),
        ({"axes": ["y"]}, "missing", False, False),
        ({"effect": "outliers"}, "missing", False, True),
        ({}, "surplus", False, True),
    ],
)
def test_an_answer_is_right_by_name_side_place_and_axis(changed, side, is_found, is_wrong):
    """A name that data do not tell from the true one is right; another place, axis or side is not."""
    told = {"effect": "time_skew", "sensors": [2], "axes": ["x"], "size": 1.0, "probability": 1.0, **changed}
    answer = {"verdict": "differs", f"{side}_in_simulation": [told]}
    outcome = PairOutcome("pair_001", KEYS, answer)
    assert outcome.finds_all == is_found and outcome.first_name_is_wrong == is_wrong
    assert outcome.other_side_is_empty == (side == "missing")


def test_the_part_that_closes_is_held_against_the_makers():
    """What is truly closed is what the maker's mend leaves of the squared gap."""
    answer, left = ({"verdict": "differs", "gap": {"before": before, "closed": 0.9}} for before in (2.0, 1.0))
    assert PairOutcome("pair_001", KEYS, answer, left).closed == (0.9, 0.75)
