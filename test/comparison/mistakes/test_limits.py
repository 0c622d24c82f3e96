"""Each limit of the search for mistakes decides where it says: a little to either side of it the answer is another."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tam_calibration.comparison.mistakes import frames, noise, units
from tam_calibration.comparison.mistakes.frames import MIRRORED_FIELDS, Frames
from tam_calibration.integrity.placement import Motion, Placement, allowed
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import from_degrees

NORTH, EAST = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])


def dipping(angle_deg, declination_deg=0.0):
    """Return a field of 50 µT so many degrees from the downward vertical, with a declination."""
    level, turn = from_degrees(angle_deg), from_degrees(declination_deg)
    return 50e-6 * np.array([np.sin(level) * np.sin(turn), np.sin(level) * np.cos(turn), -np.cos(level)])


def aside(field, angle_deg):
    """Return a field without an eastern part turned to the east."""
    angle = from_degrees(angle_deg)
    return np.cos(angle) * field + np.sin(angle) * np.linalg.norm(field) * EAST


RIGHT = dipping(50)
OTHER_HEMISPHERE, SOUTHWARDS = (MIRRORED_FIELDS[kind] @ RIGHT for kind in ("wrong_hemisphere", "south_for_north"))


@pytest.mark.parametrize(
    ("own", "right", "kind"),
    [
        (dipping(6), dipping(24), "vertical_field"),
        (dipping(8), dipping(24), None),
        (dipping(0), dipping(21), "vertical_field"),
        (dipping(0), dipping(19), None),
        (dipping(-16.5), dipping(16.5), "south_for_north"),
        (dipping(-14), dipping(14), None),
        (aside(OTHER_HEMISPHERE, 10), RIGHT, "wrong_hemisphere"),
        (aside(OTHER_HEMISPHERE, 14), RIGHT, None),
        (1.10 * OTHER_HEMISPHERE, RIGHT, "wrong_hemisphere"),
        (1.14 * OTHER_HEMISPHERE, RIGHT, None),
        (aside(SOUTHWARDS, 27), RIGHT, "south_for_north"),
        (aside(SOUTHWARDS, 33), RIGHT, None),
        (MIRRORED_FIELDS["wrong_hemisphere"] @ dipping(50, 43), dipping(50, 43), "wrong_hemisphere"),
        (MIRRORED_FIELDS["wrong_hemisphere"] @ dipping(50, 47), dipping(50, 47), None),
        (-0.55e-4 * NORTH, RIGHT, "default_field"),
        (-0.57e-4 * NORTH, RIGHT, None),
    ],
)
def test_fields_of_the_world(own, right, kind):
    """Vertical, of the other side, of another size: as one sensor reads them."""
    assert frames._kind(own, right, 1) == kind


@pytest.mark.parametrize(("deviation", "is_told"), [(0.08, True), (0.06, False)])
def test_a_world_that_hardly_turns_tells_no_field(deviation, is_told):
    """Headings all around, and roll and pitch: the vertical turns by √2 times their deviation, 0.1 at least."""
    generator = np.random.default_rng(1)
    tilts = np.column_stack([generator.normal(0, deviation, (2000, 2)), np.zeros(2000)])
    heading = Rotation.from_euler("z", generator.uniform(0, 2 * np.pi, (2000, 1)))
    motion = Motion.of((heading * Rotation.from_rotvec(tilts)).as_quat())
    found = Frames(np.eye(3)[None], OTHER_HEMISPHERE, RIGHT)
    assert (frames._mistaken_field(found, motion, motion) is not None) == is_told


@pytest.mark.parametrize(("part", "silent"), [(0.017, [1]), (0.023, [])])
def test_a_fiftieth_of_the_field_is_none(part, silent):
    """Readings of a sensor beside those of the recording."""
    one, other = (Recording(np.arange(50.0), np.full((50, 1, 3), size)) for size in (part * 3e-5, 3e-5))
    assert frames._without_field(one, other) == silent


def test_axes_that_explain_the_readings():
    """A tenth of the variance may stay; beside the best axes five times as much, and the rounding of exact sensors."""
    assert [Placement(np.full(24, share), np.zeros((24, 3)), 0.0).fits for share in (0.095, 0.105)] == [True, False]
    assert [allowed(share) for share in (0.0, 0.01, 1.0)] == pytest.approx([0.005, 0.055, 0.1])
    assert [Motion.of(np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))) is None for count in (29, 30)] == [True, False]


@pytest.mark.parametrize(("own_T", "is_told"), [(45e-3, False), (55e-3, True)])
def test_ten_times_the_recordings_intensity_may_be_right(own_T, is_told):
    """Beside a recording of 5 mT, 50 µT in millitesla."""
    assert (units._unit(own_T, 5e-3, Array.cross(0.5), True) is not None) == is_told


@pytest.mark.parametrize(("spread", "is_field"), [(0.2, True), (0.3, False)])
def test_a_field_is_steady(spread, is_field):
    """Lengths of a turning sensor's readings scatter by less than a quarter."""
    generator = np.random.default_rng(2)
    directions = generator.normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert units._is_field(50e-6 * (1 + spread * generator.normal(size=(4000, 1))) * directions) == is_field


@pytest.mark.parametrize(("turned", "is_field"), [(0.3, True), (0.2, False)])
def test_a_field_turns(turned, is_field):
    """Readings about a constant, as of a bias, are no field."""
    generator = np.random.default_rng(3)
    angle = turned * np.sign(generator.normal(size=4000))
    assert units._is_field(50e-6 * np.column_stack([np.sin(angle), np.cos(angle), np.zeros(4000)])) == is_field


@pytest.mark.parametrize(
    ("rate_hz", "kinds"),
    [
        (50e-3 * 10**0.7, ["unit_of_time"]),
        (50e-3 * 10**0.9, []),
        (1.2e6, ["time_stands_still"]),
        (0.8e6, []),
    ],
)
def test_rates_that_clocks_make(rate_hz, kinds):
    """Beside a recording of 50 Hz: milliseconds for seconds, and no time at all."""
    simulation, recording = (Recording(np.arange(50) / hz, np.full((50, 1, 3), 3e-5)) for hz in (rate_hz, 50.0))
    assert [mistake.kind for mistake in units.mistaken_stamps(simulation, recording)] == kinds


@pytest.mark.parametrize(
    ("own_T", "right_T", "name"),
    [
        (4.5**2 * 1e-9, 4.5e-9, ("variance_for_deviation", "nT")),
        (3.5**2 * 1e-9, 3.5e-9, None),
        (460e-9, 20e-9, ("variance_for_deviation", "nT")),
        (500e-9, 20e-9, None),
        (1.4 * (20e-9) ** 2, 20e-9, ("variance_for_deviation", "T")),
        (1.6 * (20e-9) ** 2, 20e-9, ("no_noise", "")),
        (1.2e-12, 15e-12, ("no_noise", "")),
        (1.8e-12, 15e-12, None),
        (0.9e-11, 1e-9, ("no_noise", "")),
        (1.1e-11, 1e-9, None),
    ],
)
def test_levels_of_noise(own_T, right_T, name):
    """Squares that are near, apart enough from the right one, and noise that is as good as none."""
    assert noise._name(own_T, right_T) == name


@pytest.mark.parametrize(("count", "channels"), [(99, 0), (100, 3)])
def test_short_sequences_are_not_compared(count, channels):
    """A hundred differences at least."""
    white = np.random.default_rng(4).normal(0, 1e-9, (count + noise.ORDER, 1, 3))
    assert len(noise._white(Recording(np.arange(len(white)) / 10, 3e-5 + white))) == channels


@pytest.mark.parametrize(("size_T", "is_noise"), [(1.5e-12, False), (3e-12, True)])
def test_rounding_is_no_noise(size_T, is_noise):
    """Of 32 bits it makes a picotesla."""
    white = noise.differences(np.random.default_rng(5).normal(0, size_T, 4000))
    assert noise.is_white(white) == is_noise


@pytest.mark.parametrize(("part", "is_white"), [(0.12, True), (0.28, False)])
def test_a_line_is_not_white(part, is_white):
    """A line at a quarter of the rate moves the autocorrelation by 1.6 times its part of the power."""
    generator = np.random.default_rng(6)
    sequence = noise.differences(generator.normal(size=8000))
    line = np.sqrt(2 * part) * np.cos(np.pi / 2 * np.arange(len(sequence)))
    assert noise.is_white(np.sqrt(1 - part) * sequence / sequence.std() + line) == is_white


@pytest.mark.parametrize(("along", "is_noise"), [(0.4, False), (0.6, True)])
def test_noise_is_along_the_field_as_across_it(along, is_noise):
    """What a motion leaves is across it: of a residual half at least lies along."""
    own = along * np.sqrt(2 / (3 - along**2))
    residual = np.random.default_rng(7).normal(size=(20_000, 3)) * [own, 1, 1]
    assert noise._is_noise(residual, np.tile([50.0, 0, 0], (20_000, 1))) == is_noise


@pytest.mark.parametrize(("turn", "is_told"), [(1.83, True), (2.09, False)])
def test_attitude_explains_a_motion_that_is_followed(turn, is_told):
    """Of turns of so many radians a sample the differences are 0.35 and 0.7 of the readings: a half is the most."""
    attitude = Rotation.from_euler("z", turn * np.arange(600)[:, None])
    readings = attitude.inv().apply([20e-6, 0, -40e-6]) + np.random.default_rng(8).normal(0, 1e-9, (600, 3))
    recording = Recording(np.arange(600.0), readings[:, None], attitude=attitude.as_quat())
    assert (noise.noise_sequence(recording, 0) is not None) == is_told


@pytest.mark.parametrize(("count", "is_told"), [(39, False), (41, True)])
def test_forty_samples_tell_noise(count, is_told):
    """Four for each number by which attitude explains an axis."""
    readings = 3e-5 + np.random.default_rng(9).normal(0, 1e-9, (count, 1, 3))
    recording = Recording(np.arange(float(count)), readings)
    assert (noise.noise_sequence(recording, 0) is not None) == is_told


@pytest.mark.parametrize(("part", "is_shared"), [(0.008, True), (0.013, False)])
def test_a_hundredth_of_its_own_makes_a_noise_unshared(part, is_shared):
    """Beside the mean of three others, whose own parts it has a third of."""
    generator = np.random.default_rng(10)
    attitude = Rotation.from_euler("XYZ", np.outer(np.arange(2000) / 100, [0.9, 0.5, 0.3]))
    field = attitude.inv().apply([1e-6, 20e-6, -45e-6])[:, None]
    own = part / np.sqrt(4 / 3) * generator.normal(0, 1e-7, (2000, 4, 3))
    recording = Recording(
        np.arange(2000) / 100, field + generator.normal(0, 1e-7, (2000, 1, 3)) + own, attitude=attitude.as_quat()
    )
    assert noise.is_shared(recording, 0) == is_shared


@pytest.mark.parametrize(("size", "is_kept"), [(4.0, True), (7.0, False)])
def test_a_difference_of_five_deviations_is_a_jerk(size, is_kept):
    """What touches it is left out."""
    sequence = np.random.default_rng(11).normal(size=(4000, 1)).clip(-3, 3)
    sequence[2000] = size
    assert (noise._without_jerks(sequence)[2000, 0] != 0) == is_kept
