"""The sealed half of the outside causes. Who writes rules of the diagnosis does not open this file."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.validation.blind.case import make_case
from tam_calibration.validation.blind.case_plan import CasePlan
from tam_calibration.validation.blind.catalogue import CATALOGUE
from tam_calibration.validation.blind.disturbance import MOVING, SWUNG
from tam_calibration.validation.blind.outside import OUTSIDE
from tam_calibration.validation.blind.outside_sealed import SEALED
from tam_calibration.validation.blind.outside_sealed_causes import _beaten, _detuned, _quanta
from tam_calibration.validation.blind.outside_sealed_whole import _between_stops, _induced, _sea, _snapped, dipole

NUMBERED = pytest.mark.parametrize("name", SEALED, ids=range(len(SEALED)))
"""Not by their names, which a report of the tests would tell."""

SMALL = {"s": 1e-4, "nT": 1.0}
"""Amplitudes by their units."""


@pytest.fixture
def disturb(draw):
    """Return a function that draws a sealed cause in one of its motions, and what it adds at so many amplitudes."""

    def disturbing(name, seed, times=1.0):
        motions = SEALED[name].motions
        scene = draw(seed, motions=(motions[seed % len(motions)],))
        cause = SEALED[name].draw(np.random.default_rng(seed), scene)
        seen = scene.readings_T, scene.intensity_T
        return cause, cause.change(times * SMALL[cause.amplitude_unit], seen)

    return disturbing


def test_there_are_ten_or_more_of_their_own():
    """No sealed kind is an open one, or an effect of the library."""
    assert len(SEALED) >= 10 and not set(SEALED) & {*OUTSIDE, *CATALOGUE}
    assert all(entry.sealed for entry in SEALED.values()) and not any(entry.sealed for entry in OUTSIDE.values())


@NUMBERED
@pytest.mark.parametrize("seed", range(4))
def test_a_cause_disturbs_one_sensor_or_the_scalar(disturb, name, seed):
    """One place is disturbed and no other, by finite numbers, and the axis is the one that the key tells."""
    cause, (vectors, scalar) = disturb(name, seed)
    assert cause.effect == name and np.isfinite(vectors).all() and np.isfinite(scalar).all()
    size = np.ptp(vectors, axis=0)
    (place,) = cause.sensors
    if place == "scalar":
        assert SEALED[name].scalar_needed and size.max() == 0 < np.ptp(scalar)
        return
    assert np.flatnonzero(size.max(axis=1)).tolist() == [place - 1] and np.ptp(scalar) == 0
    axes = ["xyz".index(axis) for axis in cause.axes] or [0, 1, 2]
    assert np.flatnonzero(size[place - 1]).tolist() == axes


@NUMBERED
def test_the_same_seed_makes_the_same_cause(disturb, name):
    """What is drawn follows from the generator and the scene."""
    (first, changes), (again, same) = disturb(name, 2), disturb(name, 2)
    assert first.parameters == again.parameters and first.sensors == again.sensors
    for one, other in zip(changes, same, strict=True):
        assert_array_equal(one, other)


@NUMBERED
def test_a_cause_grows_with_its_amplitude(disturb, name):
    """Twice the amplitude makes twice the change, or nearly so where it is a time."""
    once, twice = (np.concatenate([part.ravel() for part in disturb(name, 1, times)[1]]) for times in (1, 2))
    assert np.linalg.norm(twice) == pytest.approx(2 * np.linalg.norm(once), rel=0.02)


@NUMBERED
@pytest.mark.parametrize("gap", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_every_cause_reaches_its_gap(name, gap, seed):
    """Each is there with the gap asked for, and its key says that it is sealed."""
    case = make_case(CasePlan("outside", (name,), (gap,)), seed, 1)
    assert case.key["visible_gap"] == pytest.approx(gap, rel=0.02)
    assert [cause["sealed"] for cause in case.key["effects"]] == [True]


@NUMBERED
@pytest.mark.parametrize("known", ["temperature_drift", "quantization"])
def test_every_cause_meets_a_known_one(name, known):
    """In a mixture both have the gaps that were asked for, in other places."""
    case = make_case(CasePlan("mixed", (known, name), (2.0, 1.0)), 3, 1)
    first, second = case.key["effects"]
    assert (first["visible_gap"], second["visible_gap"]) == pytest.approx((2, 1), rel=0.02)
    assert not {*first["sensors"]} & {*second["sensors"]}


def test_what_follows_the_rate_is_drawn_in_motion_only():
    """A turntable, which stands still while a sample is taken, shows no rate."""
    names = ("coriolis_offset", "adaptive_smoothing", "image_stabiliser", "buffeted_arm")
    assert all({*SEALED[name].motions} <= {*MOVING} for name in names)


def test_an_oscillator_locks_or_beats():
    """Within the pull it comes to rest at the angle whose sine is their ratio, beyond it beats by the root."""
    steps = np.ones(200_000)
    assert np.sin(_beaten(0.05 * steps, 0.1, 0.01)[-1]) == pytest.approx(0.5, rel=1e-3)
    beats = _beaten(0.2 * steps, 0.1, 0.01)
    assert beats[-1] / (0.01 * len(steps)) == pytest.approx(np.sqrt(0.2**2 - 0.1**2), rel=0.02)


def test_quanta_are_set_to_zero():
    """They add up, and begin at nought beyond two."""
    assert_array_equal(_quanta(np.array([1.0, 0, 1, 1, -1, -1, -1, 1])), [1, 1, 2, 0, -1, -2, 0, 1])


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("motion", ["turntable", "diver", "tumbling", "figure_eight"])
def test_flux_jumps_often(change_of, seed, motion):
    """What jumps once or twice would be a bias that jumps."""
    _, _, change = change_of("flux_jumps", seed, motions=(motion,))
    steps = np.count_nonzero(np.diff(change, axis=0), axis=0)
    assert steps[steps > 0].min() >= 8


def test_a_whole_reading_ends_the_errors_of_differences(change_of):
    """The error is nought once a frame, and grows by no more than half a step at a time in between."""
    _, cause, change = change_of("delta_coding", 1)
    whole = np.flatnonzero(np.abs(change).max(axis=1) == 0)
    assert_array_equal(np.diff(whole)[1:], cause.parameters["every_samples"])
    steps = np.abs(np.diff(change, axis=0)).max(axis=1)
    assert np.delete(steps, whole[whole > 0] - 1).max() <= 1e-9


def test_an_offset_by_rotation_is_odd_in_it(change_of):
    """It is linear in the rate: with the three rates nothing is left of it."""
    scene, _, change = change_of("coriolis_offset", 1)
    rate = scene.motion.turning_rate(scene.time_s, scene.step_s / 50)
    left = change - rate @ np.linalg.lstsq(rate, change, rcond=None)[0]
    assert np.abs(left).max() < 1e-6 * np.abs(change).max()


def test_smoothing_lags_most_where_the_field_is_slow(change_of):
    """The reading is late by a time that is longer the slower it changes."""
    scene, cause, change = change_of("adaptive_smoothing", 1, amplitude=1e-3, motions=("diver",))
    reading = scene.readings_T[:, cause.sensors[0] - 1, 0]
    speed = np.diff(reading) / np.diff(scene.time_s)
    late_s = -change[1:, 0] / speed
    slow, fast = np.abs(speed) < np.quantile(np.abs(speed), 0.3), np.abs(speed) > np.quantile(np.abs(speed), 0.7)
    assert np.median(late_s[slow]) > 3 * np.median(late_s[fast]) > 0


def test_a_mode_is_left_late():
    """The detuning goes on beyond a half, and then jumps to the nearest mode."""
    assert_allclose(_detuned(np.array([0.1, 0.5, 0.65, 0.75, 0.45, 0.25]), 0.2), [0.1, 0.5, 0.65, -0.25, -0.55, 0.25])


def test_a_dipole_has_twice_the_field_on_its_axis():
    """And it is against the moment beside it."""
    field = dipole(np.array([[0, 0, 1.0], [0, 0, 1.0]]), np.array([[0, 0, 2.0], [2.0, 0, 0]]))
    assert_allclose(field, [[0, 0, 0.25], [0, 0, -0.125]])


def test_a_hung_scalar_does_not_follow_the_direction_of_the_field_alone(draw):
    """Turned about the field, the array has its magnet on another side of what hangs straight down."""
    scene = draw(1, 2000, motions=("diver",))
    _, scalar = SEALED["hung_scalar"].draw(np.random.default_rng(1), scene).change(1.0, ())
    direction = scene.field_T / scene.intensity_T[:, None]
    alike = np.argmax(direction @ direction.T - 2 * (np.abs(np.subtract.outer(*2 * [np.arange(2000)])) < 50), axis=1)
    assert np.median(np.abs(scalar - scalar[alike])) > 0.2 * scalar.std()


def test_strain_needs_weight_and_field(change_of):
    """The field of a bracket lies along one line, for the bracket and its place are the sensor's own."""
    _, _, change = change_of("stressed_iron", 1)
    sizes = np.linalg.svd(change, compute_uv=False)
    assert sizes[1] < 1e-9 * sizes[0]


def test_a_fast_conductor_screens_the_field_across():
    """At rest it has no moment, at great speed one against the field; in between one across both, half as large."""
    axle, field = np.array([0, 0, 1.0]), np.array([[1.0, 0, 1.0]])
    moments = [_induced(np.array([[speed]]), axle, field)[0] for speed in (0.0, 1.0, 1e6)]
    assert_allclose(moments, [[0, 0, 0], [-0.5, 0.5, 0], [-1, 0, 0]], atol=2e-6)


def test_a_lens_stays_at_its_stop():
    """It comes back by the next step, less what is lost."""
    assert_allclose(_between_stops(np.array([0.6, 0.9, 0.5, -0.4]), 0.5, 1.0), [0.6, 1, 1, 0.1])


def test_coils_rest_while_the_heading_does(change_of):
    """Where the whole step of the heading stays for long, so do the currents, however the ship tilts."""
    scene, cause, change = change_of("degaussing_coils", 1, motions=("turntable",))
    step = cause.parameters["step_rad"]
    whole = np.round(scene.motion.angles(scene.time_s)[:, 0] / step)
    same = np.array([len(set(whole[max(0, now - 9) : now + 1])) == 1 and now >= 9 for now in range(len(whole))])
    moved = np.linalg.norm(np.diff(change, axis=0), axis=1)
    assert not same.any() or moved[same[1:]].max() < 0.3 * moved.max()


def test_a_stabilised_camera_stays_level(change_of):
    """Its field has the moment's own size, as seen along the line to it, whatever the sensor does."""
    _, _, change = change_of("stabilised_camera", 1)
    size = np.linalg.norm(change, axis=1)
    assert size.max() / size.min() < 2.0001


def test_a_sheet_snaps_at_its_fold():
    """It stays on its side until the load against it is that of the fold, and as long on the way back."""
    load = np.array([0.0, -0.99, -1.01, 0.0, 0.99, 1.01, 5.0])
    bent = _snapped(load)
    assert_array_equal(np.sign(bent), [1, 1, -1, -1, -1, 1, 1])
    assert_allclose(4 * bent**3 - 3 * bent, load, atol=1e-12)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("motion", SWUNG)
def test_a_sheet_snaps_often(draw, seed, motion):
    """What snaps once or twice would be a mount that slips."""
    cause = SEALED["snapping_plate"].draw(np.random.default_rng(seed), draw(seed, motions=(motion,)))
    assert cause.parameters["snaps"] >= 5


def test_an_arm_trembles_across_the_field(change_of):
    """The field's length is not touched, and a fast arm trembles more than a slow one."""
    scene, cause, change = change_of("buffeted_arm", 1, motions=("diver",))
    assert_allclose((change * scene.core(cause.sensors[0] - 1)).sum(axis=1), 0, atol=1e-22)
    size = np.linalg.norm(change, axis=1)
    assert np.quantile(size, 0.9) > 5 * np.median(size[size < np.median(size)])


def test_a_radio_is_silent_most_of_the_time(change_of):
    """And never stronger than its antenna makes it at best."""
    _, cause, change = change_of("radio_bursts", 1)
    size = np.abs(change).max(axis=1)
    assert 0.05 < cause.parameters["share"] == np.mean(size > 0) < 0.5 and size.max() <= 1.5e-9


def test_a_sea_has_its_peak_and_its_groups():
    """Unit size, most power near the peak, and no two groups of waves alike."""
    heave = _sea(np.random.default_rng(1), np.arange(8192.0), 1 / 16)
    power = np.abs(np.fft.rfft(heave)) ** 2
    frequency = np.fft.rfftfreq(8192)
    assert heave.std() == pytest.approx(1, rel=0.15)
    assert frequency[np.argmax(power)] == pytest.approx(1 / 16, rel=0.1)
    middle = (frequency * power).sum() / power.sum()
    width = np.sqrt(((frequency - middle) ** 2 * power).sum() / power.sum()) / middle
    assert 0.15 < width < 0.4
