"""The laws of a gap: each is found with its sensor, axes and course, and nothing is said of noise."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tam_calibration.gap.laws as laws
from tam_calibration.gap.laws.law import causes_of
from tam_calibration.gap.laws.signature import laws_of
from tam_calibration.gap.laws.whitened import residual_of
from tam_calibration.sources.dipole import Dipole


def signature(run):
    """Return the signature of a run."""
    residual = residual_of(run.model())
    return tuple(law.signature for law in laws_of(residual, residual.excess))


def episodes(time_s):
    """Return a course that is on in four episodes."""
    return (np.sin(2 * np.pi * time_s / 15) > 0.5).astype(float)


def along_axis(run, sensor, axis):
    """Return the field (N,) along an axis of a sensor, tesla."""
    readings = run.recording.readings_T[:, sensor] - run.errors.bias_T[sensor]
    return readings[:, axis]


@pytest.mark.parametrize("sheet", [1.0, 1.1])
def test_nothing_is_said_of_noise(run, sheet):
    """White noise of the stated size has no law, whether the sheet is right or off by a tenth."""
    assert signature(run(seed=2, sheet=sheet)) == ()


def test_a_step_of_an_offset(run):
    """An offset that steps once: its sensor, its axis, its time, its size, and its share of the gap."""
    clean = run(samples=450)
    time_s = clean.recording.time_s
    (law,) = signature(clean.with_row(7, 3e-9 * (time_s > 22)))
    assert (law.law, law.course, law.sensors, law.axes) == ("offset", "step", (3,), ("y",))
    assert law.times_s == pytest.approx((22.0,), abs=0.3)
    assert law.energy > 0.85
    assert law.curve is not None
    assert np.ptp(law.curve.size) == pytest.approx(3e-9, abs=3 * law.curve.error.max())


def test_an_offset_of_many_levels(run):
    """An offset that steps to seven levels, of which no two are the same, has each step at its time."""
    clean = run(samples=900)
    time_s = clean.recording.time_s
    edges_s = time_s[-1] * np.array([0.1, 0.24, 0.38, 0.46, 0.65, 0.85])
    levels_T = 1e-9 * np.array([0.0, 9.0, -4.0, 6.0, -9.0, 2.0, -6.0])
    (law,) = signature(clean.with_row(7, levels_T[np.searchsorted(edges_s, time_s, side="right")]))
    assert (law.law, law.course, law.sensors, law.axes) == ("offset", "step", (3,), ("y",))
    assert law.times_s == pytest.approx(edges_s.tolist(), abs=0.3)


def test_a_smooth_drift_is_no_row_of_steps(run):
    """An offset that drifts up and down is slow."""
    clean = run(samples=900)
    time_s = clean.recording.time_s
    first = signature(clean.with_row(7, 9e-9 * np.sin(2 * np.pi * time_s / np.ptp(time_s))))[0]
    assert (first.law, first.course, first.sensors) == ("offset", "slow", (3,))


def test_an_arm_that_drag_bends(run):
    """A sensor that turns by the square of the rate of turning has a law of the rate that goes with the motion."""
    clean = run(samples=900)
    residual = residual_of(clean.model())
    bend = np.linalg.norm(residual.turning, axis=1, keepdims=True) * residual.turning @ np.diag([1.0, 0.2, 0.5])
    added = np.zeros((900, clean.row_count))
    added[:, 3:6] = 3e-9 * np.cross(bend, residual.field)
    first = signature(clean.with_added(added))[0]
    assert (first.law, first.course, first.sensors) == ("rate", "motion", (2,))


def test_a_wreck_that_passes(run):
    """A dipole that drifts by at six metres changes the gradient at all sensors for a while."""
    clean = run(samples=900)
    time_s, attitude = clean.recording.time_s, Rotation.from_quat(clean.recording.attitude)
    wreck = Dipole(np.array([0.0, 6.0, 0.0]), np.array([150.0, 400.0, -250.0]))
    array_m = np.outer((time_s - 30) / 2, [1.0, 0.1, 0.0])
    sensors = [wreck.field_T(array_m + attitude.apply(one)) for one in clean.array.positions_m]
    scalar = np.sum(wreck.field_T(array_m) * attitude.apply(residual_of(clean.model()).field), axis=1)
    added = np.column_stack([*(attitude.inv().apply(one) for one in sensors), scalar])
    passed = clean.with_added(added)
    first = signature(passed)[0]
    assert (first.law, first.sensors, first.follows) == ("attitude", (1, 2, 3, 4), None)
    assert first.course in ("slow", "episodes", "step")
    assert first.energy > 0.9
    without = replace(passed, recording=replace(passed.recording, attitude=None))
    for law in signature(without)[:3]:
        assert (1, 2, 3, 4) in law.places
        assert causes_of(law)[0].name == "disturbed_field"


def test_a_large_gradient(run):
    """A field that is not uniform by thousands of the noise leaves no sensor that any other law explains."""
    clean = run(samples=900)
    attitude = Rotation.from_quat(clean.recording.attitude)
    gradient = 1e-5 * np.array([[1.0, 0.5, 0.0], [0.5, -0.6, 0.8], [0.0, 0.8, -0.4]])
    sensors = [attitude.inv().apply(attitude.apply(one) @ gradient) for one in clean.array.positions_m]
    first = signature(clean.with_added(np.column_stack([*sensors, np.zeros(900)])))[0]
    assert (first.law, first.course, first.sensors) == ("attitude", "motion", (1, 2, 3, 4))


def test_a_heading_error_is_no_part_of_a_gradient(run):
    """An error of the scalar by direction and a field that is not uniform are two laws, though attitude makes both."""
    clean = run(samples=900)
    residual, attitude = residual_of(clean.model()), Rotation.from_quat(clean.recording.attitude)
    gradient_T_per_m = 2e-8 * np.array([[1.0, 0.5, 0.0], [0.5, -0.6, 0.8], [0.0, 0.8, -0.4]])
    sensors = [attitude.inv().apply(attitude.apply(one) @ gradient_T_per_m) for one in clean.array.positions_m]
    heading = 10e-9 * (residual.field @ [0.6, -0.64, 0.48]) ** 3
    laws = signature(clean.with_added(np.column_stack([*sensors, heading])))
    assert {(law.law, law.sensors) for law in laws[:2]} == {("attitude", ("scalar",)), ("attitude", (1, 2, 3, 4))}


def test_an_axis_that_falls_behind_in_fast_turns(run):
    """An axis that is off where its own field changes fast has a law of the rate that goes with the motion."""
    clean = run(samples=900)
    rate = residual_of(clean.model()).sensed_rate[:, 4]
    behind = np.sign(rate) * np.maximum(np.abs(rate) - np.quantile(np.abs(rate), 0.6), 0)
    first = signature(clean.with_row(4, 5e-9 * behind / np.abs(behind).max()))[0]
    assert (first.law, first.course, first.sensors, first.axes) == ("rate", "motion", (2,), ("y",))


def test_an_error_of_the_scalar_that_follows_direction_and_grows(run):
    """What depends on direction, and the more the later, is a law of direction with a slow course."""
    clean = run(samples=900)
    residual = residual_of(clean.model())
    along = residual.field @ [0.6, -0.64, 0.48]
    late = clean.recording.time_s / clean.recording.time_s[-1]
    first = signature(clean.with_row(clean.row_count - 1, 8e-9 * late**2 * along))[0]
    assert (first.law, first.course, first.sensors) == ("attitude", "slow", ("scalar",))


def test_a_gain_in_episodes(run):
    """A gain that falls in four episodes follows nothing that was recorded."""
    clean = run(samples=600)
    change = -1e-4 * episodes(clean.recording.time_s) * along_axis(clean, 1, 2)
    first = signature(clean.with_row(5, change))[0]
    assert (first.law, first.course, first.sensors, first.axes) == ("gain", "episodes", (2,), ("z",))
    assert first.follows is None
    assert len(first.times_s) in (7, 8)


def test_an_offset_that_follows_a_channel(run):
    """An offset proportional to the current names the channel."""
    clean = run(samples=300)
    first = signature(clean.with_row(3, 1.5e-9 * clean.recording.current_A))[0]
    assert (first.law, first.course, first.sensors, first.follows) == ("offset", "channel", (2,), "current")


def test_a_delay(run):
    """A sensor that is late has a law of the rate of change, which stays."""
    clean = run(samples=300)
    sensed = clean.recording.readings_T[:, 2] - clean.errors.bias_T[2]
    rate = np.gradient(sensed, clean.recording.time_s, axis=0)
    added = np.zeros((300, clean.row_count))
    added[:, 6:9] = -2e-4 * rate
    first = signature(clean.with_added(added))[0]
    assert (first.law, first.course, first.sensors) == ("rate", "constant", (3,))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_step_beside_a_delay_is_no_gain_that_drifts(run, seed):
    """A free course of a gain imitates the sum of two laws of one sensor, which explain more together."""
    clean = run(samples=600, seed=seed)
    sensed, time_s = clean.recording.readings_T[:, 2] - clean.errors.bias_T[2], clean.recording.time_s
    added = np.zeros((600, clean.row_count))
    added[:, 6:9] = 5e-9 * np.outer(time_s > 22, [1, -0.7, 0.5]) - 2e-4 * np.gradient(sensed, time_s, axis=0)
    laws = signature(clean.with_added(added))
    assert [(law.law, law.course, law.sensors) for law in laws] == [
        ("rate", "constant", (3,)),
        ("offset", "step", (3,)),
    ]


def test_a_jump_is_no_part_of_a_drift_elsewhere(run):
    """A sensor that steps while another drifts has a law of its own, though the drift explains half of the step."""
    clean = run(samples=900)
    time_s, added = clean.recording.time_s, np.zeros((900, clean.row_count))
    middle = time_s[len(time_s) // 2]
    added[:, 3] = 16e-9 * (time_s / middle + 0.3 * np.sin(2 * np.pi * time_s / middle))
    added[:, 10] = 15e-9 * (time_s > middle)
    laws = {law.sensors: law for law in signature(clean.with_added(added))}
    assert (laws[2,].law, laws[2,].course) == ("offset", "slow")
    assert (laws[4,].law, laws[4,].course, laws[4,].axes) == ("offset", "step", ("y",))
    assert laws[4,].times_s == pytest.approx((middle,), abs=1)


def test_a_jump_is_no_part_of_a_drift_that_a_channel_explains(run):
    """The same where the drift follows a recorded temperature that rises."""
    clean = run(samples=900)
    time_s = clean.recording.time_s
    middle, added = time_s[len(time_s) // 2], np.zeros((900, clean.row_count))
    temperature_C = 15 + 5 * time_s / middle
    added[:, 3] = 4e-9 * (temperature_C - 15)
    added[:, 10] = 15e-9 * (time_s > middle)
    warm = clean.with_added(added)
    warm = replace(warm, recording=replace(warm.recording, temperature_C=temperature_C))
    told = {law.sensors: (law.law, law.course) for law in signature(warm)}
    assert told == {(2,): ("offset", "channel"), (4,): ("offset", "step")}


def test_a_curved_axis(run):
    """A cubic of an axis' own reading is a law of that reading."""
    clean = run(samples=300)
    own = along_axis(clean, 3, 0)
    first = signature(clean.with_row(9, 5e-9 * (own / 5e-5) ** 3 * 4))[0]
    assert (first.law, first.course, first.sensors, first.axes) == ("own_field", "motion", (4,), ("x",))


def test_a_tone(run):
    """A hum above the motion is a tone, with its frequency."""
    clean = run(samples=900)
    first = signature(clean.with_row(0, 2e-9 * np.sin(2 * np.pi * 4.3 * clean.recording.time_s)))[0]
    assert (first.law, first.course, first.sensors) == ("offset", "tone", (1,))
    assert float(first.follows.split()[0]) == pytest.approx(4.3, abs=0.01)


@pytest.mark.parametrize("change", [0.0, 0.5])
def test_the_size_of_a_tone_is_that_of_its_waves(run, change):
    """From peak to peak, also where its amplitude changes and is no constant of the fit."""
    clean = run(samples=900)
    time_s = clean.recording.time_s
    amplitude = 10e-9 * (1 - change + change * np.sin(0.2 * time_s))
    first = signature(clean.with_row(0, amplitude * np.sin(2 * np.pi * 4.3 * time_s)))[0]
    assert first.course == "tone"
    assert np.ptp(first.curve.size) == pytest.approx(20e-9, rel=0.1)


@pytest.mark.parametrize(("frequency_hz", "is_tone"), [(3.0, True), (0.25, False)])
def test_a_gain_with_a_tone_is_faster_than_the_motion(run, frequency_hz, is_tone):
    """At the pace of the motion, 0.14 Hz about its fastest axis, it would imitate what goes with that."""
    clean = run(samples=600)
    wave = np.sin(2 * np.pi * frequency_hz * clean.recording.time_s)
    first = signature(clean.with_row(5, 1e-4 * wave * along_axis(clean, 1, 2)))[0]
    assert (first.sensors, first.axes) == ((2,), ("z",))
    assert ((first.law, first.course) == ("gain", "tone")) is is_tone


def test_a_noisy_axis(run):
    """White noise that is larger in one axis predicts nothing, and is told as variance."""
    clean = run(samples=300)
    noise = np.random.default_rng(5).normal(size=300)
    first = signature(clean.with_row(4, 2e-9 * noise))[0]
    assert (first.law, first.course, first.sensors, first.axes) == ("noise", "random", (2,), ("y",))
    in_spans = signature(clean.with_row(4, 4e-9 * noise * episodes(clean.recording.time_s)))[0]
    assert (in_spans.law, in_spans.course) == ("noise", "episodes")


@pytest.mark.parametrize("goes_with", ["reading", "rate"])
def test_noise_that_goes_with_the_motion(run, goes_with):
    """Noise in proportion to an axis' own reading, or to its rate of change, follows the motion."""
    clean = run(samples=300)
    own = along_axis(clean, 1, 1)
    size = own if goes_with == "reading" else np.gradient(own)
    noise = np.random.default_rng(5).normal(size=(300, 3)) * (2e-9 * np.abs(size) / np.abs(size).mean())[:, None]
    added = np.zeros((300, clean.row_count))
    added[:, 3:6] = noise
    first = signature(clean.with_added(added))[0]
    assert (first.law, first.course, first.follows, first.sensors) == ("noise", "motion", "motion", (2,))


def test_noise_that_follows_a_channel(run):
    """Brushes spark more at larger currents: their noise follows the current."""
    clean = run(samples=300)
    current = clean.recording.current_A
    noise = np.random.default_rng(5).normal(size=300) * (current - current.min())
    first = signature(clean.with_row(4, 1e-9 * noise))[0]
    assert (first.law, first.course, first.follows, first.sensors) == ("noise", "channel", "current", (2,))


def test_noise_of_a_reference(run):
    """A noisy reference multiplies the three readings of a sensor, so that noise has the direction of the field."""
    clean = run(samples=300)
    part = 5e-5 * np.random.default_rng(5).normal(size=300)
    added = np.zeros((300, clean.row_count))
    for axis in range(3):
        added[:, 3 + axis] = part * along_axis(clean, 1, axis)
    first = signature(clean.with_added(added))[0]
    assert (first.law, first.course, first.sensors) == ("gain", "random", (2,))


def test_spikes(run):
    """Single deviations in one axis, each of its own size and sign, are samples."""
    clean = run(samples=300)
    added = np.zeros(300)
    added[np.arange(37, 300, 59)] = 60e-9 * np.random.default_rng(2).normal(size=5)
    first = signature(clean.with_row(8, added))[0]
    assert (first.law, first.sensors, first.axes) == ("samples", (3,), ("z",))


def test_spikes_in_all_sensors(run):
    """Single deviations in all axes of all sensors at once sit in all of them."""
    clean = run(samples=300)
    added = np.zeros((300, clean.row_count))
    added[40::80, :12] = 60e-9 * np.random.default_rng(2).normal(size=(4, 12))
    first = signature(clean.with_added(added))[0]
    assert (first.law, first.sensors) == ("samples", (1, 2, 3, 4))


def test_single_readings_whose_time_is_off(run):
    """Readings of a sensor that change places with the next ones are off along the rate of change of the field."""
    clean = run(samples=300)
    readings = clean.recording.readings_T[:, 1].copy()
    for sample in range(20, 290, 30):
        readings[[sample, sample + 1]] = readings[[sample + 1, sample]]
    added = np.zeros((300, clean.row_count))
    added[:, 3:6] = readings - clean.recording.readings_T[:, 1]
    (law,) = signature(clean.with_added(added))
    assert (law.law, law.course, law.sensors) == ("rate", "random", (2,))


def test_readings_that_are_held(run):
    """A sensor that repeats its readings is told by these, though they also follow the motion."""
    clean = run(samples=300)
    readings = clean.recording.readings_T.copy()
    for sample in range(20, 290, 30):
        readings[sample : sample + 3, 1] = readings[sample - 1, 1]
    change = (readings - clean.recording.readings_T).reshape(300, -1)
    first = signature(clean.with_added(np.column_stack([change, np.zeros(300)])))[0]
    assert (first.law, first.sensors) == ("samples", (2,))


def test_a_sensor_at_half_the_rate_has_lost_no_reading(run):
    """Readings that are interpolated to the rate of the others count: a step has its whole share of the gap."""
    clean = run(samples=1200)
    readings = clean.recording.readings_T.copy()
    readings[1:-1:2, 1] = (readings[:-2:2, 1] + readings[2::2, 1]) / 2
    slow = replace(clean, recording=replace(clean.recording, readings_T=readings))
    first = signature(slow.with_row(7, 1e-6 * (clean.recording.time_s > 22)))[0]
    assert (first.law, first.course, first.sensors, first.axes) == ("offset", "step", (3,), ("y",))
    assert first.energy > 0.9


def test_a_drift_of_the_scalar_may_be_a_field_that_all_sensors_feel(run):
    """The places hold both, as the residual of the intensity alone sees either; a recorded attitude decides."""
    clean = run(samples=300)
    drift = 1e-9 * np.sin(2 * np.pi * clean.recording.time_s / 45)
    drifting = clean.with_row(12, drift)
    assert [(one.law, one.places) for one in signature(drifting)] == [("offset", (("scalar",),))]
    without = replace(drifting, recording=replace(drifting.recording, attitude=None))
    assert [(one.law, one.places) for one in signature(without)] == [("offset", (("scalar",), (1, 2, 3, 4)))]


def test_sensors_that_share_a_course_have_one_law(run):
    """A cable of two sensors that is loose is one law of both; a step in another sensor stays its own."""
    clean = run(samples=400)
    time_s = clean.recording.time_s
    loose = episodes(time_s)
    shared = clean.with_row(2, 4e-9 * loose).with_row(9, -3e-9 * loose).with_row(4, 3e-9 * (time_s > 30))
    found = {(one.law, one.course, one.sensors) for one in signature(shared)}
    assert found == {("offset", "episodes", (1, 4)), ("offset", "step", (2,))}


def in_sensors(run, of_sensors):
    """Return a run to whose sensors (from 1) signals (N, 3) are added."""
    added = np.zeros((run.recording.sample_count, run.row_count))
    for sensor, signal in of_sensors.items():
        added[:, 3 * sensor - 3 : 3 * sensor] = signal
    return run.with_added(added)


def test_a_law_of_many_sensors_names_them_all(run):
    """A load that all sensors feel, each along its own direction, one of them a tenth as much as others."""
    clean = run(samples=600)
    course = episodes(clean.recording.time_s)[:, None]
    sizes_T = 3e-9 * np.array([[1, 0, 0.5], [0, -1, 0.5], [0.1, 0.2, 0], [-0.5, 0, 1]])
    found = signature(in_sensors(clean, {sensor: course * size for sensor, size in enumerate(sizes_T, 1)}))
    assert (found[0].law, found[0].course, found[0].sensors) == ("offset", "episodes", (1, 2, 3, 4))


@pytest.mark.parametrize("sensors", [(1, 2), (2, 4)])
def test_pulses_in_two_sensors_name_both(run, sensors):
    """Pulses at the same samples of two sensors, in each of its own size and direction."""
    clean, rng = run(samples=600), np.random.default_rng(7)
    pulses = np.zeros((600, 1))
    pulses[40::90] = 1.0
    put = {sensor: pulses * rng.normal(0, 2e-8, (600, 3)) for sensor in sensors}
    (first,) = signature(in_sensors(clean, put))
    assert (first.law, first.sensors, first.places) == ("samples", sensors, (sensors,))


def test_laws_of_two_sensors_that_are_not_one_stay_apart(run):
    """A curved axis of one, and gains of another that wander, which a curve imitates in part."""
    clean = run(samples=900)
    time_s, own = clean.recording.time_s, along_axis(clean, 3, 0)
    curved = np.outer(2e-8 * (own / 5e-5) ** 3, [1.0, 0, 0])
    sensed = clean.recording.readings_T[:, 1] - clean.errors.bias_T[1]
    wandering = 3e-5 * np.sin(2 * np.pi * time_s / 31)[:, None] * sensed[:, [1, 2, 0]]
    found = {one.law: one.sensors for one in signature(in_sensors(clean, {4: curved, 2: wandering}))}
    assert found["own_field"] == (4,) and found["gain"] == (2,)


def test_a_tone_whose_pace_wanders(run):
    """Of a rotor: its phase walks by a radian within some turns, and the tone is one of an offset all the same."""
    clean = run(samples=900)
    walk = np.cumsum(np.random.default_rng(3).normal(size=900)) * 0.15
    wave = 4e-9 * np.sin(2 * np.pi * 2.3 * clean.recording.time_s + walk)
    first = signature(in_sensors(clean, {2: np.outer(wave, [1.0, -0.5, 0.3])}))[0]
    assert (first.law, first.course, first.sensors) == ("offset", "tone", (2,))


def test_noise_of_several_sensors(run):
    """Brushes beside two of four sensors: their noise is told of both, and of no third."""
    clean = run(samples=600)
    noise = 4e-9 * np.random.default_rng(8).normal(size=(2, 600, 3))
    first = signature(in_sensors(clean, {1: noise[0], 4: noise[1]}))[0]
    assert (first.law, first.course, first.sensors) == ("noise", "random", (1, 4))


def test_shares_are_those_of_samples_that_were_not_fitted(run):
    """Of an offset in one sensor beside white noise of its size in another, each has about half of the gap."""
    clean = run(samples=750)
    noise = np.random.default_rng(8).normal(size=750)
    changing = 2e-9 * np.sign(np.sin(clean.recording.time_s / 1.3))
    both = clean.with_row(4, changing).with_row(11, 2e-9 * noise)
    shares = {one.law: one.energy for one in signature(both)}
    assert shares["offset"] == pytest.approx(0.5, abs=0.12)
    assert shares["noise"] == pytest.approx(0.5, abs=0.12)


@pytest.mark.parametrize("row", [4, 12])
@pytest.mark.parametrize("size_T", [3e-9, 300e-9])
def test_large_noise_of_a_channel_is_no_spikes(run, row, size_T):
    """Its largest values lie far from their neighbours; they explain only a part of it."""
    clean = run(samples=300)
    noisy = clean.with_row(row, size_T * np.random.default_rng(9).normal(size=300))
    (first,) = signature(noisy)
    assert (first.law, first.course) == ("noise", "random") and first.energy > 0.8
    assert first.sensors == (("scalar",) if row == 12 else (2,))


def test_decisions_stand_in_one_place():
    """No other module of the laws has a number of its own at module level, and the one has at most forty names."""
    folder = Path(laws.__file__).parent
    found = {
        path.name: [
            target.id
            for one in ast.parse(path.read_text()).body
            if isinstance(one, ast.Assign)
            for target in one.targets
            if isinstance(target, ast.Name) and target.id.isupper()
        ]
        for path in folder.glob("*.py")
    }
    decisions = found.pop("decisions.py")
    assert len(decisions) <= 40
    assert [name for names in found.values() for name in names if name not in ("AXES", "CAUSES")] == []
