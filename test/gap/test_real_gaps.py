"""Real recordings of one sensor without a scalar: what is known of them comes out, and nothing is made up."""

from pathlib import Path

import pytest

from tam_calibration.files import read_array, read_recording
from tam_calibration.gap import diagnose

RECORDINGS = Path(__file__).parents[3] / "shared" / "data" / "recordings"

pytestmark = pytest.mark.skipif(
    not RECORDINGS.is_dir(),
    reason=f"the recordings of phones and a tracked sensor are not part of the package, and not at {RECORDINGS}",
)


def gap_of(name):
    """Return the diagnosis of a recording."""
    array = read_array(RECORDINGS / ("broad.yaml" if name.startswith("broad") else "phones.yaml"))
    return diagnose(read_recording(RECORDINGS / f"{name}.csv"), array)


def status_of(gap, effect):
    """Return what became of a hypothesis."""
    return next(one.status for one in gap.considered if one.effect == effect)


def test_a_magnet_in_the_middle_is_a_step_on_and_a_step_off():
    """broad_32: the steps of about 58 µT come with their times, and the gap nearly closes."""
    gap = gap_of("broad_32")
    assert gap.verdict == "explained"
    first = gap.causes[0]
    assert (first.fitted.effect, first.sensors) == ("bias_jump", (1,))
    assert 36 < first.fitted.shape["time_s"] < 53
    assert 93 < first.fitted.shape["end_s"] < 164
    assert max(abs(one.values["offset"]) for one in first.fitted.contributions) > 40e-6
    assert gap.size.closed > 0.95


def test_the_gradients_of_a_room_are_not_blamed_on_the_sensor():
    """broad_03: a gap that no effect of the library explains, as no position was recorded."""
    gap = gap_of("broad_03")
    assert gap.verdict == "unexplained"
    assert gap.causes == ()
    assert status_of(gap, "hysteresis") == "not_supported"
    assert status_of(gap, "temperature_drift") == "channel_missing"
    assert status_of(gap, "ambient_gradient") == "not_identifiable"


@pytest.mark.parametrize("name", ["nexus5_d1", "iphone5_d3"])
def test_phones_tell_which_channels_are_missing(name):
    """What a phone did not record is said of every effect that needs it."""
    gap = gap_of(name)
    assert gap.where.sensors in ((), (1,))
    for effect in ("temperature_drift", "current_interference", "ambient_gradient", "scalar_heading_error"):
        assert status_of(gap, effect) == "channel_missing"
