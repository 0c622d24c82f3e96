"""The search for causes: what explains a law is named in its sensor, what does not is not."""

from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from tam_calibration.effects.effect import Contribution, Finding, FittedEffect
from tam_calibration.effects.library import installed_effects
from tam_calibration.gap import diagnose
from tam_calibration.gap.diagnose import judge
from tam_calibration.gap.laws.law import Signature
from tam_calibration.gap.laws.signature import Law
from tam_calibration.gap.model import Model
from tam_calibration.gap.search import Offers, candidates, is_plausible
from tam_calibration.gap.steps import Search
from tam_calibration.model.recording import Recording

search_module = import_module("tam_calibration.gap.search")

SAMPLES = 300


def switched(made, times, row=4, size=15e-9):
    """Return the run with an offset of one axis that changes sides at each of the times."""
    side = 1.0 - 2.0 * (np.searchsorted(times, made.recording.time_s) % 2)
    return made.with_row(row, size * side)


@pytest.mark.parametrize("samples_a_period", [2, 3])
def test_a_tone_whose_harmonic_looks_like_it_is_its_line(run, samples_a_period):
    """At half the sampling rate the third harmonic has the same alias, and the sine is zero at every sample."""
    made = run(600)
    turns = np.arange(600) / samples_a_period
    made = made.with_row(4, 20e-9 * np.cos(2 * np.pi * turns))
    (cause,) = diagnose(made.recording, made.array).causes
    assert (cause.fitted.effect, cause.sensors) == ("periodic_interference", (2,))
    assert {one.term for one in cause.fitted.contributions} == {"line"}
    values = [one.values for one in cause.fitted.contributions if one.axis == 1]
    assert np.hypot(*values[0].values()) == pytest.approx(20e-9, rel=0.05)


def test_three_jumps_are_jumps(run):
    """What changes sides no more often has a place in the library."""
    made = switched(run(SAMPLES), [12.0, 30.0, 44.0])
    gap = diagnose(made.recording, made.array)
    assert gap.verdict == "explained"
    assert {(cause.fitted.effect, cause.sensors) for cause in gap.causes} == {("bias_jump", (2,))}


@pytest.mark.parametrize("axes", [1, 3])
def test_a_slow_fall_is_no_staircase(run, axes):
    """A gain that falls by and by until it stays: three steps leave a fiftieth of it, and are no cause of it."""
    made = run(2 * SAMPLES)
    time_s = made.recording.time_s
    since = np.maximum(time_s / time_s[-1] - 0.2, 0)
    fallen = -np.expm1(-((since / 0.3) ** 1.5))
    for row in range(3, 3 + axes):
        reading_T = made.recording.readings_T.reshape(len(time_s), -1)[:, row]
        made = made.with_row(row, -2e-4 * fallen * reading_T)
    gap = diagnose(made.recording, made.array)
    assert (gap.verdict, gap.causes) == ("unexplained", ())
    assert [(law.law, law.course, law.sensors) for law in gap.signature] == [("gain", "slow", (2,))]


def test_what_comes_and_goes_is_no_jump(run):
    """A loose contact that changes sides eight times is none of the library, and its sensor is told."""
    made = switched(run(SAMPLES), [5.0, 11.0, 19.0, 24.0, 33.0, 40.0, 46.0, 55.0])
    gap = diagnose(made.recording, made.array)
    assert gap.verdict == "unexplained"
    assert (gap.where.sensors, gap.where.axes) == ((2,), ("y",))


def test_a_product_of_two_axes_is_no_loop(run):
    """What an axis feels across it is neither its hysteresis nor, together with that, its nonlinearity."""
    made = run(SAMPLES)
    field = made.errors.restore(made.recording.readings_T).mean(axis=1)
    x, y, z = field.T / np.linalg.norm(field, axis=1)
    made = made.with_row(8, 20e-9 * x * y * (1 + 0.5 * z))
    gap = diagnose(made.recording, made.array)
    assert gap.verdict == "unexplained"
    assert (gap.where.sensors, gap.where.axes) == ((3,), ("z",))


def taken_up_again(made, order):
    """Return the run with its poses in an order, each with noise of its own."""
    attitude = made.recording.attitude[order]
    exact = made.errors.distort(Rotation.from_quat(attitude).inv().apply([12e-6, 18e-6, -45e-6]))
    generator = np.random.default_rng(3)
    readings = exact + made.array.vector_noise_T[:, None] * generator.normal(size=exact.shape)
    scalar = made.intensity_T + made.array.scalar_noise_T * generator.normal(size=len(order))
    recording = Recording(np.arange(len(order)) * 10.0, readings, scalar, attitude=attitude)
    return replace(made, recording=recording)


def test_what_goes_with_the_pose_is_no_loop(run):
    """A function of the field that is the same whenever a pose is taken up on the same way is no hysteresis."""
    made = taken_up_again(run(72), np.tile(np.repeat(np.arange(36), 2), 2))
    direction = np.random.default_rng(3).normal(size=3)
    field = made.errors.restore(made.recording.readings_T).mean(axis=1)
    along = field @ direction / (np.linalg.norm(field, axis=1) * np.linalg.norm(direction))
    bent = np.tanh(4 * along)
    gap = diagnose(made.with_row(4, 20e-9 * bent / np.std(bent)).recording, made.array)
    assert (gap.verdict, gap.where.sensors) == ("unexplained", (2,))


@pytest.mark.parametrize(("sensors", "is_possible"), [((1,), True), ((0,), False), ((1, 2), False)])
def test_readings_of_other_sensors_are_no_cause(run, sensors, is_possible):
    """Single readings that were found in more sensors than a law does not explain it."""
    parts = tuple(Contribution(sensor, None, "held", {}, {}) for sensor in sensors)
    form = Finding(FittedEffect("stale_samples", {}, parts), gain=100.0, parameter_count=1)
    law = Signature("rate", "random", (2,), ("x", "y", "z"), 1.0, ((2,),), None, (), 100.0)
    offer = SimpleNamespace(effect="stale_samples", form=form)
    assert is_plausible(run().model().base(), offer, law) is is_possible


def test_what_the_readings_prove_is_tried_first(run):
    """An axis that stays at the end of its range comes before a step of its scale, of which it may look like one."""
    made = clipped(run(SAMPLES), 45e-6)
    law = Law(Signature("gain", "step", (3,), ("x", "y", "z"), 1.0, ((3,),), None, (), 100.0), 0.1)
    model = Model.nominal(made.recording, made.array)
    offers = next(Offers(model, (), lambda *_: None).of(model.base(), law, ()))
    assert offers[0].effect == "saturation"


@pytest.mark.parametrize("bend", [6e-3, 1e-2])
def test_two_effects_that_look_like_a_free_gain_are_named(run, bend):
    """A sensor whose gain follows the temperature, and whose axis is bent: neither leaves little of the law."""
    made = run(900)
    recording = made.recording
    warmth = lfilter([0.02], [1, -0.98], recording.temperature_C - recording.temperature_C[0])
    field = made.errors.restore(recording.readings_T)[:, 0]
    generator = np.random.default_rng(1)
    added = np.zeros((900, made.row_count))
    added[:, :3] = warmth[:, None] * (3e-9 * generator.normal(size=3) + 1e-4 * generator.normal(size=3) * field)
    added[:, 0] += bend * (7e-5 * np.tanh(field[:, 0] / 7e-5) - field[:, 0])
    gap = diagnose(made.with_added(added).recording, made.array)
    assert gap.verdict == "explained"
    assert {(one.fitted.effect, one.sensors) for one in gap.causes} == {
        ("temperature_drift", (1,)),
        ("nonlinearity", (1,)),
    }


@pytest.mark.parametrize(("gain", "tried"), [(99.0, ["time_skew"]), (80.0, ["time_skew", "eddy_current"])])
def test_a_special_case_that_explains_less_comes_before_the_general_effect(monkeypatch, gain, tried):
    """Where it explains nearly as much the general effect is not tried at all."""
    special, general = SimpleNamespace(effect="time_skew", gain=gain), SimpleNamespace(effect="eddy_current", gain=100)
    monkeypatch.setattr(search_module, "special_case", lambda best, others: special)
    monkeypatch.setattr(search_module, "is_plausible", lambda *_: True)
    assert [one.effect for one in candidates(None, [general, special], None)] == tried


def test_a_special_case_beyond_nature_takes_no_place(monkeypatch):
    """Eddy currents are offered where a field of the vehicle that explains as much would be too large."""
    special, general = (
        SimpleNamespace(effect="platform_field", gain=99),
        SimpleNamespace(effect="eddy_current", gain=100),
    )
    monkeypatch.setattr(search_module, "special_case", lambda best, others: special if special in others else best)
    monkeypatch.setattr(search_module, "is_plausible", lambda base, one, law: one is not special)
    assert [one.effect for one in candidates(None, [general, special], None)] == ["eddy_current"]


def test_a_drift_of_the_scalar_is_named_where_poses_are_taken_up_again(run):
    """It is not the same at both visits to a pose, as the sensors' own differences would be."""
    made = taken_up_again(run(72), np.tile(np.arange(72), 2))
    gap = diagnose(made.with_row(12, 3e-9 * np.linspace(-1, 1, 144) ** 2).recording, made.array)
    assert [(one.fitted.effect, one.sensors) for one in gap.causes] == [("geomagnetic_drift", ("scalar",))]


def beside_a_jump(made, disturbance_T, size_T):
    """Return a run with a disturbance (N, 3) of the third sensor, whose offsets jump too."""
    jump_T = size_T * np.outer(made.recording.time_s > 22, [1, -0.7, 0.5])
    for axis, added in enumerate((disturbance_T + jump_T).T):
        made = made.with_row(6 + axis, added)
    return made


def test_two_causes_in_one_sensor_are_named(run):
    """A jump beside a delay; a gain of any course would explain nearly as much."""
    clean = run(600)
    sensed_T = clean.recording.readings_T[:, 2] - clean.errors.bias_T[2]
    late_T = -2e-4 * np.gradient(sensed_T, clean.recording.time_s, axis=0)
    made = beside_a_jump(clean, late_T, 15e-9)
    gap = diagnose(made.recording, made.array)
    assert gap.verdict == "explained"
    assert {(one.fitted.effect, one.sensors) for one in gap.causes} == {("bias_jump", (3,)), ("time_skew", (3,))}


@pytest.mark.parametrize("noise_T", [0.0, 4e-9])
def test_neither_of_two_laws_has_a_cause_where_one_has_none(run, noise_T):
    """The two may stand for a law that is neither: a jump beside products of the field's components is not named.

    Nor is noise of the same sensor, as beside any larger law without a cause.
    """
    clean = run(600)
    field = clean.errors.restore(clean.recording.readings_T).mean(axis=1)
    x, y, z = field.T / np.linalg.norm(field, axis=1)
    noise = noise_T * np.random.default_rng(3).normal(size=(600, 3))
    made = beside_a_jump(clean, 20e-9 * np.column_stack([x * y, y * z, x * z]) + noise, 10e-9)
    gap = diagnose(made.recording, made.array)
    assert {(law.law, law.sensors) for law in gap.signature} >= {("offset", (3,)), ("attitude", (3,))}
    assert (gap.verdict, gap.causes) == ("unexplained", ())


def test_a_law_without_a_cause_is_tried_again_beside_another_cause(monkeypatch):
    """The larger of two laws has a cause only beside that of the smaller one, and is open until then."""
    larger, smaller = (
        SimpleNamespace(signature=SimpleNamespace(law=law, sensors=(1,)), found=(), part=0.5)
        for law in ("gain", "rate")
    )
    search = object.__new__(search_module._CauseSearch)
    search._steps, search._open, search._tell = [], [], lambda *_: None
    asked = []

    def explain(law, _):
        asked.append(law)
        if law is larger and not search._steps:
            return None
        search._steps.append(law)
        return (larger,) if law is smaller else ()

    for name, stub in {"_explain": explain, "_laws_of": lambda left: left, "_is_small": lambda _: False}.items():
        monkeypatch.setattr(search, name, stub)
    assert search._explain_all((larger, smaller), set()) == ()
    assert asked == [larger, smaller, larger]
    assert search._open == []


def test_the_sizes_of_spikes_in_two_sensors_are_stated_for_both(run):
    """Each has its rate and size, and no other sensor."""
    clean, struck = run(SAMPLES), slice(20, None, 40)
    pulses = np.zeros((SAMPLES, clean.row_count))
    for first in (3, 9):
        pulses[struck, first : first + 3] = np.random.default_rng(first).normal(0, 3e-8, pulses[struck, :3].shape)
    made = clean.with_added(pulses)
    (cause,) = diagnose(made.recording, made.array).causes
    assert (cause.fitted.effect, cause.sensors) == ("outliers", (2, 4))
    assert [part.sensor for part in cause.fitted.contributions] == [1, 3]


def test_spikes_of_one_axis_are_in_that_one(run):
    """Also where a single reading of another sensor is far off."""
    spikes, other = np.zeros((2, SAMPLES))
    spikes[[30, 111, 190, 222]] = 1e-7, -1.2e-7, 0.8e-7, 1.1e-7
    other[77] = 12e-9
    made = run(SAMPLES).with_row(7, spikes).with_row(1, other)
    gap = diagnose(made.recording, made.array)
    assert [(one.fitted.effect, one.sensors, one.axes) for one in gap.causes] == [("outliers", (3,), ("y",))]
    assert [(law.law, law.sensors, law.axes) for law in gap.signature] == [("samples", (3,), ("y",))]


def test_readings_that_were_filled_in_are_no_spikes(run):
    """Where no effect that is tried fills readings in they stay unexplained."""
    clean = run(600)
    readings, added = clean.recording.readings_T[:, 1], np.zeros((600, clean.row_count))
    for start in range(50, 590, 80):
        line = np.linspace(readings[start - 1], readings[start + 9], 11)[1:-1]
        added[start : start + 9, 3:6] = line - readings[start : start + 9]
    made = clean.with_added(added)
    gap = diagnose(made.recording, made.array, without=["stale_samples", "interpolated_samples"])
    assert "outliers" not in [cause.fitted.effect for cause in gap.causes]
    assert gap.signature[0].sensors == (2,) and gap.verdict != "explained"


def test_noise_is_no_cause_beside_an_open_law(run):
    """At shuffled poses a rectified field has a law without a cause; what it leaves is not taken for noise."""
    generator = np.random.default_rng(23)
    made = taken_up_again(run(72), generator.permutation(np.tile(np.arange(72), 2)))
    direction, along = generator.normal(size=(2, 3))
    field = made.errors.restore(made.recording.readings_T).mean(axis=1)
    bent = np.abs(field @ direction)
    added = np.outer(bent - bent.mean(), along)
    added *= 15e-9 / np.sqrt(np.mean(np.sum(added**2, axis=1)))
    for axis in range(3):
        made = made.with_row(6 + axis, added[:, axis])
    gap = diagnose(made.recording, made.array)
    assert (gap.verdict, gap.where.sensors) == ("unexplained", (3,))


def test_what_weight_moves_is_told_as_unexplained(run):
    """A loose magnet that rolls with the tilt is neither noise nor an arm that bends."""
    made = run(SAMPLES)
    up = Rotation.from_quat(made.recording.attitude).inv().apply([0.0, 0.0, 1.0])
    made = made.with_row(4, 15e-9 * np.tanh(8 * (up[:, 0] + 0.3)))
    gap = diagnose(made.recording, made.array)
    assert (gap.verdict, gap.where.sensors) == ("unexplained", (2,))


def test_what_strikes_often_is_no_outlier(run):
    """Wrong readings in one sample of twelve are more than outliers."""
    made = run(SAMPLES)
    generator = np.random.default_rng(5)
    hit = generator.random(SAMPLES) < 1 / 12
    made = made.with_row(4, np.where(hit, 60e-9 * generator.choice([-1.0, 1.0], SAMPLES), 0.0))
    gap = diagnose(made.recording, made.array)
    assert (gap.verdict, gap.where.sensors) == ("unexplained", (2,))


def searched(energy, left, *, causes=1, at=(2,)):
    """Return a search whose cause of sensor 2 leaves so much energy in each of 500 channels, in part as a law."""
    nominal, model = (
        SimpleNamespace(
            base=lambda energy=energy: SimpleNamespace(
                energy=500 * energy, channels=SimpleNamespace(count=500), rank=2
            ),
            findings=(),
        )
        for energy in (4.0, energy)
    )
    law = Signature("offset", "slow", at, ("x",), 0.5, (at,), None, (), 50.0)
    steps = (SimpleNamespace(law=replace(law, places=((2,),))),) * causes
    return Search(nominal, model, steps, (), (Law(law, left),), (), ())


@pytest.mark.parametrize(
    ("energy", "left", "further", "is_clean"),
    [
        (1.95, 0.05, {}, True),
        (2.05, 0.05, {}, False),
        (1.5, 0.17, {}, True),
        (1.5, 0.20, {}, False),
        (1.5, 0.0, {"causes": 0}, False),
        (1.5, 0.05, {"at": (3,)}, False),
    ],
)
def test_a_search_is_clean_where_its_causes_leave_nothing(energy, left, further, is_clean):
    """No more than a noise floor beside the noise, a tenth of the laws in their sensors, and no law elsewhere."""
    found = searched(energy, left, **further)
    assert found.is_clean == is_clean
    assert found.evidence == pytest.approx(-500 * np.log(energy) - 2 * np.log(500))


def test_what_the_laws_have_left_is_their_open_part():
    """A third of an energy of 1.5 beside 2.5 that the causes explain, and nothing without a law."""
    assert searched(1.5, 1 / 3).open_part == pytest.approx(0.5 / 3.0)
    assert searched(1.5, 0.0).open_part == 0


def late(made, sensor, delay_s):
    """Return what a sensor reads other when it samples late."""
    turned = [
        Rotation.from_euler("XYZ", np.outer(time, [0.9, 0.55, 0.35])).inv().apply([12e-6, 18e-6, -45e-6])
        for time in (made.recording.time_s, made.recording.time_s - delay_s)
    ]
    added = np.zeros((made.recording.sample_count, made.row_count))
    added[:, 3 * sensor : 3 * sensor + 3] = (turned[1] - turned[0]) @ made.errors.matrix[sensor].T
    return made.with_added(added)


def direction(made):
    """Return the direction of the field in the array frame."""
    field = made.errors.restore(made.recording.readings_T).mean(axis=1)
    return field / np.linalg.norm(field, axis=1)[:, None]


def warmed(made, row=4, slope=4e-9, lag_s=4.0):
    """Return the run with an axis that follows the temperature with a lag, by small steps of time."""
    time = made.recording.time_s
    temperature, followed = made.recording.temperature_C - 20, []
    state = temperature[0]
    for step, value in zip(np.diff(time, prepend=time[0]), temperature, strict=True):
        state += (1 - np.exp(-step / lag_s)) * (value - state)
        followed.append(state)
    return made.with_row(row, slope * np.array(followed))


def bent(made, row=8, size=25e-9):
    """Return the run with an axis whose reading bends towards its full scale."""
    along = made.recording.readings_T[:, row // 3, row % 3] / 6e-5
    return made.with_row(row, size * (np.tanh(1.5 * along) - along))


def wired(made):
    """Return the run with a cable beside sensor 1."""
    return made.with_added(made.recording.current_A[:, None] * np.array([4e-9, 0, -3e-9] + [0] * 10))


def hummed(made):
    """Return the run with a pump of 2.3 Hz in sensor 4."""
    return made.with_row(9, 5e-9 * np.sin(2 * np.pi * 2.3 * made.recording.time_s + 0.7))


def spiked(made, times=1.0):
    """Return the run with a dozen spikes in sensor 2."""
    generator = np.random.default_rng(7)
    spikes = np.zeros((SAMPLES, 13))
    hit = generator.choice(SAMPLES, 12, replace=False)
    spikes[hit[:, None], np.arange(3, 6)] = generator.choice([-1, 1], (12, 3)) * generator.uniform(
        30e-9, 90e-9, (12, 3)
    )
    return made.with_added(times * spikes)


def noisy(made):
    """Return the run with three times the noise in one axis."""
    return made.with_row(7, np.sqrt(8) * 1e-9 * np.random.default_rng(7).normal(size=SAMPLES))


def rounded(made):
    """Return the run with sensor 1 rounded to 12 nT."""
    readings = made.recording.readings_T[:, 0]
    added = np.zeros((SAMPLES, 13))
    added[:, :3] = 12e-9 * np.round(readings / 12e-9) - readings
    return made.with_added(added)


def clipped(made, limit_T):
    """Return the run with an axis that reads no more than a limit."""
    readings = made.recording.readings_T.copy()
    readings[:, 2, 0] = np.minimum(readings[:, 2, 0], limit_T)
    return replace(made, recording=replace(made.recording, readings_T=readings))


def headed(made):
    """Return the run with a scalar magnetometer that reads less along an axis of its own."""
    along = direction(made) @ np.array([0.6, 0.0, 0.8])
    return made.with_row(12, 6e-9 * along**3 * np.abs(along))


CASES = {
    "current_interference": (wired, (1,)),
    "periodic_interference": (hummed, (4,)),
    "outliers": (spiked, (2,)),
    "noise_excess": (noisy, (3,)),
    "quantization": (rounded, (1,)),
    "saturation": (lambda made: clipped(made, 45e-6), (3,)),
    "scalar_heading_error": (headed, ("scalar",)),
}


@pytest.mark.parametrize("name", CASES)
def test_a_single_effect_is_named_in_its_sensor(run, name):
    """Made otherwise than the library fits it, and well visible, it is the only cause and explains the gap."""
    disturb, sensors = CASES[name]
    made = disturb(run(SAMPLES))
    gap = diagnose(made.recording, made.array)
    assert gap.verdict == "explained"
    assert {cause.fitted.effect for cause in gap.causes} == {name}
    assert gap.where.sensors == sensors
    assert gap.size.after < 0.35 * gap.size.before
    assert gap.probabilities[name] > 0.5 and sum(gap.probabilities.values()) == pytest.approx(1)


def test_a_single_gross_spike_is_an_outlier(run):
    """One reading of a millitesla in one sensor."""
    made = run(SAMPLES)
    made = made.with_added(1e-3 * (np.arange(SAMPLES) == 100)[:, None] * (np.arange(13) // 3 == 2))
    gap = diagnose(made.recording, made.array)
    assert {cause.fitted.effect for cause in gap.causes} == {"outliers"}


def test_two_effects_are_both_found(run):
    """A drift of sensor 2 and a curve of sensor 3, each in its place, with shares that add up."""
    made = bent(warmed(run(SAMPLES)), size=50e-9)
    gap = diagnose(made.recording, made.array)
    assert gap.verdict == "explained"
    assert {(cause.fitted.effect, cause.sensors) for cause in gap.causes} == {
        ("temperature_drift", (2,)),
        ("nonlinearity", (3,)),
    }
    assert sum(cause.share for cause in gap.causes) == pytest.approx(1)


def test_a_drift_beside_spikes_that_are_most_of_the_gap_is_found(run):
    """Samples that are left out need no model, whose errors could look like a small law."""
    made = spiked(bent(run(SAMPLES)), times=300)
    gap = diagnose(made.recording, made.array)
    assert gap.verdict == "explained"
    assert {(cause.fitted.effect, cause.sensors) for cause in gap.causes} == {
        ("outliers", (2,)),
        ("nonlinearity", (3,)),
    }


def test_noise_does_not_hide_a_weaker_cause_in_its_sensor(run):
    """More variance would take for noise what bends with the reading."""
    made = bent(noisy(run(SAMPLES)), row=7, size=20e-9)
    gap = diagnose(made.recording, made.array)
    assert gap.verdict == "explained"
    assert [cause.fitted.effect for cause in gap.causes] == ["noise_excess", "nonlinearity"]
    assert {cause.sensors for cause in gap.causes} == {(3,)}


def test_noise_is_named_beside_a_smaller_law_without_a_cause(run):
    """What no effect makes, in the axis of which the noise is larger."""
    made = noisy(run(SAMPLES))
    x, y, z = direction(made).T
    made = made.with_row(7, 6e-9 * np.sin(7 * x * y + 5 * z * z) * np.cos(0.2 * made.recording.time_s))
    judged = judge(made.recording, made.array)
    laws = [law.signature.law for law in judged.found.laws]
    assert laws[0] == "noise" and len(laws) > 1
    assert [cause.fitted.effect for cause in judged.gap.causes] == ["noise_excess"]


def test_a_sensor_that_is_rounded_and_noisy_has_an_answer(run):
    """Noise of a sensor whose readings are rounded is a part of that cause."""
    made = run(SAMPLES)
    step, noise = 5e-9, 2e-9 * np.random.default_rng(4).normal(size=(SAMPLES, 3))
    added = np.zeros((SAMPLES, 13))
    readings = made.recording.readings_T[:, 0]
    added[:, :3] = step * (np.round(readings / step) + np.round(noise / step)) - readings
    gap = diagnose(made.with_added(added).recording, made.array)
    assert gap.verdict in ("explained", "partly_explained")
    assert {(cause.fitted.effect, cause.sensors) for cause in gap.causes} == {("quantization", (1,))}


@pytest.mark.parametrize("period_s", [4.0, 25.0])
def test_a_delay_that_goes_on_is_no_jitter(run, period_s):
    """A sensor that runs at a rate of its own is late by more and more, and then by less: no scatter of its times."""
    made = run(SAMPLES)
    delay_s = 1.5e-3 * (made.recording.time_s / period_s % 1 - 0.5)
    gap = diagnose(late(made, 1, delay_s).recording, made.array)
    assert "timing_jitter" not in {cause.fitted.effect for cause in gap.causes}
    assert gap.where.sensors == (2,)


@pytest.fixture(scope="module")
def lagging(run):
    """Return the diagnosis of a run in which two sensors follow the temperature, and what was told on the way."""
    made, told = run(SAMPLES), []
    made = warmed(warmed(made, row=4, slope=10e-9, lag_s=0.5), row=6, slope=10e-9, lag_s=12.0)
    return diagnose(made.recording, made.array, progress=lambda what, part: told.append((what, part))), told


def test_each_sensor_may_have_a_lag_of_its_own(lagging):
    """Two sensors that follow the temperature at once and late are one cause in both."""
    gap, _ = lagging
    assert gap.verdict == "explained"
    assert {cause.fitted.effect for cause in gap.causes} == {"temperature_drift"}
    assert gap.where.sensors == (2, 3)


@pytest.mark.parametrize(
    ("sensors", "has_scalar", "sheet"),
    [(1, True, 1.0), (1, False, 1.0), (2, False, 1.0), (4, True, 0.88), (4, True, 1.12), (6, False, 1.0)],
)
def test_noise_is_no_gap(run, sensors, has_scalar, sheet):
    """Whatever the array, and whatever is 12 % wrong in its data sheet for all alike; no law is seen."""
    made = run(SAMPLES, sensors, has_scalar, seed=3, sheet=sheet)
    judged = judge(made.recording, made.array)
    assert (judged.gap.verdict, judged.gap.causes, judged.gap.where.sensors) == ("no_gap", (), ())
    assert judged.found.steps == judged.found.laws == judged.found.remaining == ()


def test_what_no_effect_makes_is_unexplained(run):
    """A product of attitude and time in one sensor: no cause is forced, and the sensor is told."""
    made = run(SAMPLES)
    x, y, z = direction(made).T
    strange = np.sin(7 * x * y + 5 * z * z) * np.cos(0.2 * made.recording.time_s)
    made = made.with_row(4, 15e-9 * strange)
    gap = diagnose(made.recording, made.array)
    assert gap.verdict == "unexplained" and gap.causes == ()
    assert gap.where.sensors == (2,)
    assert gap.size.before > 0.5


def test_an_effect_that_is_not_tried_leaves_its_gap_open(run):
    """No other takes all of it."""
    made = warmed(run(SAMPLES))
    tried = {"nonlinearity", "bias_jump", "current_interference", "periodic_interference", "noise_excess", "outliers"}
    gap = diagnose(made.recording, made.array, without=set(installed_effects()) - tried)
    assert gap.verdict in ("unexplained", "partly_explained")
    assert "temperature_drift" not in {cause.fitted.effect for cause in gap.causes}


def test_a_special_case_that_is_left_out_stands_beside_what_holds_it(run):
    """What explains a plain delay shows no more than a delay would, which is then no cause."""
    made = late(run(SAMPLES), 2, 5e-4)
    (cause,) = diagnose(made.recording, made.array, without=["time_skew"]).causes
    assert cause.sensors == (3,) and "time_skew" in cause.indistinguishable_from


def test_progress_is_told(lagging):
    """Stages by name, from 0 to 1, and never back."""
    _, told = lagging
    assert told[0] == ("nominal calibration", 0.0) and {"laws", "temperature_drift"} <= {what for what, _ in told}
    parts = [part for _, part in told]
    assert 0 <= min(parts) <= max(parts) <= 1 and parts == sorted(parts)
