"""Raw values of a stream become SI: units by the size of the field, counters that overflow, axes of the world."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from inspected import COUNT, columns_of, times, turned, write_text
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import EARTH_FIELD, FieldBounds
from tam_calibration.model.units import to_nanotesla
from tam_calibration.recordings import read_recording
from tam_calibration.recordings.channel_map import Pick
from tam_calibration.recordings.intake import Counter, Intake, field_size, likely_unit
from tam_calibration.sources.dipole import field_alone

SIZES = {"T": 48e-6, "mT": 0.048, "uT": 48.0, "nT": 48_000.0, "G": 0.48, "mG": 480.0}
"""The Earth's field in each unit."""

NORMALISED = {
    "time_s": times(first_ns=0) / 1e9,
    **{f"mag_{axis}": turned(1.0)[:, number] for number, axis in enumerate("xyz")},
}


def intake(stream="tam_1", pick=None, unwrap=False):
    """Return an intake for a turned sensor whose unit is not stated, or as a pick says."""
    return Intake(stream, pick or Pick(topic="/mag"), EARTH_FIELD, unwrap)


@pytest.mark.parametrize(("unit", "size"), SIZES.items())
@pytest.mark.parametrize("stream", ["tam_1", "scalar"])
def test_a_unit_is_detected_by_the_size_of_the_field(stream, unit, size):
    """The same field in any unit is the same number of tesla, whose unit is told as detected."""
    one = intake(stream)
    raw = turned(size) if stream == "tam_1" else np.linalg.norm(turned(size), axis=1, keepdims=True)
    values, codes = one.take(raw)
    assert (one.unit, one.is_detected) == (unit, True) and not codes.any()
    assert_allclose(values, raw * 48e-6 / size, rtol=1e-12)


@settings(deadline=None)
@given(st.floats(22e-6, 67e-6), st.sampled_from(list(SIZES)))
def test_no_field_of_the_earth_fits_two_units(intensity_T, unit):
    """Whatever its intensity, it is the Earth's in the unit in which it was written, and in no other."""
    assert likely_unit(intensity_T * SIZES[unit] / SIZES["T"], "", EARTH_FIELD) == unit


@settings(deadline=None, max_examples=30)
@given(st.lists(st.floats(-2, 2), min_size=3, max_size=3))
def test_a_bias_does_not_hide_the_size_of_the_field(bias):
    """Of a sensor that was turned all round the radius counts, not the length of its readings."""
    assert field_size(turned(48_000) + 48_000 * np.array(bias)) == pytest.approx(48_000, rel=0.01)


@pytest.mark.parametrize("seed", range(6))
def test_a_pass_without_turning_shows_the_length_of_the_field(seed):
    """Past a dipole the readings are a short course, which many spheres fit: a small one has another unit."""
    offset = np.column_stack([np.arange(-5.5, 6.5, 0.06), np.full(200, -1.0), np.full(200, 2.5)])
    field = np.array([19.5e3, 2.4e3, -43.8e3]) + to_nanotesla(field_alone(offset, np.array([20.0, -30.0, 80.0])))
    readings = field + np.random.default_rng(seed).normal(0, 3, (200, 3))
    assert field_size(readings) == pytest.approx(np.median(np.linalg.norm(field, axis=1)), rel=1e-3)


def test_a_stated_unit_or_size_of_a_count_is_not_questioned():
    """Also where the field would be that of no place on Earth."""
    raw = turned(30.0)
    assert_allclose(intake(pick=Pick(topic="/mag", unit="nT")).take(raw)[0], raw * 1e-9)
    assert_allclose(intake(pick=Pick(topic="/mag", scale_nT=0.15)).take(raw)[0], raw * 0.15e-9)


def test_a_normalised_field_needs_a_scale(tmp_path):
    """It says so in one sentence; with the intensity as the size of a count it is read."""
    path = write_text(tmp_path / "run.csv", NORMALISED)
    with pytest.raises(InputError, match="sensor 1 reads a field of 1, which seems to be normalised: state scale_nT"):
        read_recording(path)
    columns = {"sensors": [{"columns": ["mag_x", "mag_y", "mag_z"], "scale_nT": 48_000}]}
    assert_allclose(read_recording(path, map=columns).readings_T[:, 0], turned(1.0) * 48e-6)


def test_the_field_of_the_array_tells_a_unit(tmp_path):
    """In a coil of 2 mT the same numbers have another unit than on Earth."""
    columns = {f"mag_{axis}": column for axis, column in zip("xyz", turned(2.0).T, strict=True)}
    path = write_text(tmp_path / "run.csv", {"time_s": times(first_ns=0) / 1e9, **columns})
    coil = Array(np.zeros((1, 3)), field=FieldBounds(1e-3, 4e-3))
    assert_allclose(read_recording(path, array=coil).readings_T[:, 0], turned(2.0) * 1e-3)
    with pytest.raises(InputError, match="in no unit the Earth's"):
        read_recording(path)


def test_three_components_are_the_intensity():
    """A vector magnetometer in the place of the scalar gives its length."""
    values, _ = intake("scalar", Pick(topic="/f", unit="nT")).take(np.array([[3.0, 4.0, 12.0]]))
    assert_allclose(values, [[13e-9]])


@settings(deadline=None, max_examples=30)
@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda parts: np.linalg.norm(parts) > 0.1))
def test_an_attitude_in_north_east_down_is_turned(quaternion):
    """North, east and down of its world become y, x and -z of ours; the vector in the body is the same."""
    north_east_down = Rotation.from_quat(quaternion)
    pick = Pick(topic="/attitude", world="ned")
    (turned_quaternion,), _ = intake("attitude", pick).take(north_east_down.as_quat()[None])
    ours = Rotation.from_quat(turned_quaternion)
    for body in np.eye(3):
        north, east, down = north_east_down.apply(body)
        assert_allclose(ours.apply(body), [east, north, -down], atol=1e-12)


def wrapped(bits, step=1.0, size=0.7, first=0, count=4000):
    """Return readings (n, 3) in steps, and as a counter of some bits shows x and y, from some sample on."""
    span = step * 2.0**bits
    exact = step * np.round(turned(size * span, count) / step)
    shown = exact.copy()
    shown[:, :2] = (exact[:, :2] + span / 2) % span - span / 2
    return exact[first:], shown[first:]


@pytest.mark.parametrize("bits", [8, 12, 16, 24])
@pytest.mark.parametrize("step", [1.0, 0.15, 6.25e-9])
def test_a_counter_that_overflows_is_named(bits, step):
    """With its axis and width, whatever the size of a count; nothing is read until that is asked for."""
    _, shown = wrapped(bits, step)
    with pytest.raises(InputError) as problem:
        intake(pick=Pick(topic="/mag", unit="nT")).take(shown)
    jumps = int((np.abs(np.diff(shown[:, 0])) > 0.75 * step * 2**bits).sum())
    assert str(problem.value) == (
        f"sensor 1 axis x jumps {jumps} times by 2^{bits} counts: its counter of {bits} bits overflows; "
        "read it with --unwrap"
    )


@pytest.mark.parametrize("bits", [8, 12, 16, 24])
@pytest.mark.parametrize("batches", [1, 7])
def test_overflows_are_taken_out(bits, batches):
    """In one batch or several the readings are those before the counter, to the very bit."""
    exact, shown = wrapped(bits)
    one = intake(pick=Pick(topic="/mag", scale_nT=1e9), unwrap=True)
    parts = [one.take(part)[0] for part in np.array_split(shown, [2000, *range(2100, 2100 + 100 * batches, 100)])]
    assert_array_equal(np.concatenate(parts), exact)


def late(bits, still=1000):
    """Return readings as of ``wrapped`` that first stay within the range of the counter for some samples."""
    exact, _ = wrapped(bits)
    exact[:still] = np.round(exact[:still] * np.linspace(0.3, 0.4, still)[:, None])
    exact[still : still + 100] = np.round(exact[still : still + 100] * np.linspace(0.4, 1, 100)[:, None])
    shown = exact.copy()
    shown[:, :2] = (exact[:, :2] + 2.0**bits / 2) % 2.0**bits - 2.0**bits / 2
    assert (shown[:still] == exact[:still]).all() and (shown != exact).any()
    return exact, shown


@pytest.mark.parametrize("parts", [2, 5])
def test_overflows_may_begin_in_a_later_batch(parts):
    """Readings that overflow after the first batch only are refused, or unwrapped, as in one batch."""
    exact, shown = late(16)
    batches = np.array_split(shown, parts)
    one = intake(pick=Pick(topic="/mag", scale_nT=1e9), unwrap=True)
    assert_array_equal(np.concatenate([one.take(batch)[0] for batch in batches]), exact)
    other = intake(pick=Pick(topic="/mag", scale_nT=1e9))
    with pytest.raises(InputError, match=r"its counter of 16 bits overflows; read it with --unwrap"):
        for batch in batches:
            other.take(batch)


def test_a_sensor_may_have_axes_that_are_no_counters():
    """The steps of each axis tell its counter: others may be written with more digits."""
    exact, shown = wrapped(16)
    for readings in (exact, shown):
        readings[:, 2] += 0.37 * np.random.default_rng(0).normal(size=len(readings))
    values, _ = intake(pick=Pick(topic="/mag", scale_nT=1e9), unwrap=True).take(shown)
    assert_array_equal(values, exact)


@pytest.mark.parametrize("first", range(1, 120, 13))
def test_a_recording_may_begin_after_an_overflow(first):
    """Where the counter has turned before the first reading the intensity tells it."""
    exact, shown = wrapped(16, first=first)
    values, _ = intake(pick=Pick(topic="/mag", scale_nT=1e9), unwrap=True).take(shown)
    assert_array_equal(values, exact)


def test_missing_readings_do_not_hide_overflows():
    """NaN between them stays NaN, the others go on."""
    exact, shown = wrapped(16)
    gone = np.arange(len(shown)) % 10 == 4
    shown[gone] = np.nan
    values, codes = intake(pick=Pick(topic="/mag", scale_nT=1e9), unwrap=True).take(shown)
    assert_array_equal(codes == 1, gone)
    assert_array_equal(values[~gone], exact[~gone])


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1), st.floats(0.001, 10), st.sampled_from(["turns", "poses", "noise"]))
def test_sound_readings_show_no_overflow(seed, step, kind):
    """A sensor that is turned evenly, set from pose to pose, or at rest is no counter that overflows."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(COUNT, 3))
    poses = 48_000 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    readings = {"turns": turned(48_000), "poses": poses, "noise": 300 * directions}[kind]
    assert not Counter.of(step * np.round(readings / step)).axes


def test_a_single_reading_far_off_is_no_overflow():
    """Whatever the sizes: readings that are no whole counts are of no counter."""
    rng = np.random.default_rng(7)
    for size in np.geomspace(1e5, 1e7, 300):
        readings = turned(48_000) + rng.normal(size=(COUNT, 3))
        readings[50] = -size
        assert not Counter.of(readings).axes


def test_unwrapping_is_asked_for_by_the_reader(tmp_path):
    """``unwrap`` of `read_recording` reads what is refused without it."""
    exact, shown = wrapped(16, size=0.73)
    columns = {"time_s": np.arange(len(shown)) / 20, **columns_of("mag_", shown)}
    path = write_text(tmp_path / "run.csv", columns)
    with pytest.raises(InputError, match="read it with --unwrap"):
        read_recording(path)
    assert_allclose(read_recording(path, unwrap=True).readings_T[:, 0], exact * 1e-9, rtol=1e-12)
