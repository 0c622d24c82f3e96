"""Real recordings of one sensor without a scalar: what is known of them comes out, and nothing is made up."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.linalg import norm

from tam_calibration.effects.states import BiasJump
from tam_calibration.gap import diagnose
from tam_calibration.gap.diagnose import judge
from tam_calibration.gap.hypothesis import EVERYWHERE
from tam_calibration.gap.joint import sandwich
from tam_calibration.gap.laws.signature import times_of
from tam_calibration.gap.model import Model
from tam_calibration.gap.regression import Base
from tam_calibration.gap.size import examine
from tam_calibration.recordings import read_array, read_recording

RECORDINGS = Path(__file__).parents[3] / "shared" / "data" / "recordings"

pytestmark = pytest.mark.skipif(
    not RECORDINGS.is_dir(),
    reason=f"the recordings of phones and a tracked sensor are not part of the package, and not at {RECORDINGS}",
)


def gap_of(name, rows=slice(None)):
    """Return the diagnosis of a recording, or of some rows of it."""
    array = read_array(RECORDINGS / ("broad.yaml" if name.startswith("broad") else "phones.yaml"))
    return diagnose(read_recording(RECORDINGS / f"{name}.csv").take(rows), array)


def status_of(gap, effect):
    """Return what became of a hypothesis."""
    return next(one.status for one in gap.considered if one.effect == effect)


def test_a_magnet_in_the_middle_is_a_step_on_and_a_step_off():
    """broad_32: the steps of about 58 µT come with their times beside an unknown part, and the gap nearly closes."""
    gap = gap_of("broad_32")
    assert gap.verdict == "partly_explained"
    first = gap.causes[0]
    assert (first.fitted.effect, first.sensors) == ("bias_jump", (1,))
    assert 36 < first.fitted.shape["time_s"] < 53
    assert 93 < first.fitted.shape["end_s"] < 164
    assert max(abs(one.values["offset"]) for one in first.fitted.contributions) > 40e-6
    assert gap.size.closed > 0.95


@pytest.mark.parametrize("noise_T", [15e-9, 750e-9, None])
@pytest.mark.parametrize(
    ("name", "times", "size"),
    [
        ("broad_33", (42.4, 98.5), (-3056e-9, -309e-9, 26890e-9)),
        ("broad_32", (38.35, 95.27), (-6691e-9, -513e-9, 59401e-9)),
    ],
)
def test_a_magnet_on_and_off_is_found_by_attitude_whatever_noise_is_stated(name, times, size, noise_T):
    """Times to a second, size to 15 % and direction to 15°, of broad_32 as the lengths of its readings tell them."""
    recording, array = read_recording(RECORDINGS / f"{name}.csv"), read_array(RECORDINGS / "broad.yaml")
    noise = None if noise_T is None else np.array([noise_T])
    judged = judge(recording, replace(array, vector_noise_T=noise))
    assert judged.found.model.world is not None
    jump = judged.gap.causes[0].fitted
    assert jump.effect == "bias_jump"
    assert list(jump.shape.values()) == pytest.approx(times, abs=1)
    offset = np.array([one.values["offset"] for one in jump.contributions])
    assert norm(offset) == pytest.approx(norm(size), rel=0.15)
    assert offset @ size > np.cos(np.radians(15)) * norm(offset) * norm(size)


@pytest.mark.parametrize(("name", "rest_T"), [("broad_02", 0.92e-6), ("broad_08", 1.79e-6)])
@pytest.mark.parametrize("until", [0.77, 2.0])
def test_a_jump_of_three_times_the_rest_is_found(name, rest_T, until):
    """Put into a run that has none: times to a second, offset to 20 %, and its interval holds what was put in."""
    recording, array = read_recording(RECORDINGS / f"{name}.csv"), read_array(RECORDINGS / "broad.yaml")
    phase = (recording.time_s - recording.time_s[0]) / np.ptp(recording.time_s)
    put = 3 * rest_T * np.array([0.3, 0.9, -0.3]) / norm([0.3, 0.9, -0.3])
    inside = (phase > 0.42) & (phase < until)
    readings = recording.readings_T + inside[:, None, None] * put
    nominal = Model.nominal(replace(recording, readings_T=readings), array)
    found = examine(nominal.base(), BiasJump(), EVERYWHERE, times_of(nominal))
    model = nominal.accept(found.form)
    times = recording.time_s[inside][[0, -1]] if until < 1 else recording.time_s[inside][:1]
    assert list(found.form.shape.values()) == pytest.approx(times, abs=1)
    channels = model.channels(model.signal())
    (part,) = model.parts
    deviation = part.values - put
    assert norm(deviation) < 0.2 * norm(put)
    error = np.sqrt(np.diag(sandwich(Base(channels, [channels.calibration]), [channels.design(part.terms(channels))])))
    assert (np.abs(deviation) < 3 * error).all()


def test_the_gradients_of_a_room_are_not_blamed_on_the_sensor():
    """broad_03, a third of it: what changes slowly with the place is stated as a law, and gets no name.

    No position was recorded. The readings were interpolated, which neither a delay nor an eddy current makes exactly.
    """
    gap = gap_of("broad_03", slice(38_310 // 3))
    assert gap.verdict == "unexplained" and gap.size.after > 1
    assert (gap.signature[0].sensors, gap.signature[0].course) == ((1,), "slow")
    for effect in ("hysteresis", "eddy_current", "time_skew"):
        assert status_of(gap, effect) == "not_supported"
    assert status_of(gap, "temperature_drift") == "channel_missing"
    assert status_of(gap, "ambient_gradient") == "not_identifiable"


@pytest.mark.parametrize("name", ["nexus5_d1", "iphone5_d3"])
def test_phones_tell_which_channels_are_missing(name):
    """What a phone did not record is said of every effect that needs it."""
    gap = gap_of(name)
    assert gap.where.sensors in ((), (1,))
    for effect in ("temperature_drift", "current_interference", "ambient_gradient", "scalar_heading_error"):
        assert status_of(gap, effect) == "channel_missing"
