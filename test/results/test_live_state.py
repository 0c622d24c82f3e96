"""What was learned, on disk and back."""

from dataclasses import replace

import numpy as np
import pytest
from live_mission import ashore, dive
from numpy.testing import assert_array_equal

from tam_calibration.live.live import Change, Live
from tam_calibration.model.exceptions import InputError
from tam_calibration.results.sample_file import read_live_state, write_live_state


@pytest.fixture(scope="module")
def state(true_errors, cross):
    """Return what ten seconds of a dive leave, and a change that was told."""
    generator = np.random.default_rng(1)
    live = Live(ashore(true_errors, cross, generator), "tell")
    live.add(dive(true_errors, cross, generator, np.arange(0, 10, 0.1)))
    changes = (Change(7.5, "bias of sensor 2 by x +1 nT", 2, ("bias", "scale factor")),)
    return replace(live.state, changes=changes, paused_by="sensors")


def test_a_state_comes_back_to_the_bit(state, tmp_path):
    """With the calibration's text, what was told, and all numbers."""
    path = tmp_path / "samples.live"
    write_live_state(path, state, "text of it")
    found, text = read_live_state(path, 4)
    assert text == "text of it"
    assert (found.paused_by, found.learned, found.changes) == (state.paused_by, state.learned, state.changes)
    assert (found.energy, found.freedom) == (state.energy, state.freedom)
    for one, other in (
        (found.recursion.begin, state.recursion.begin),
        (found.recursion.now, state.recursion.now),
        (found.published, state.published),
    ):
        assert_array_equal(one.errors.to_vector(), other.errors.to_vector())
        assert_array_equal(one.covariance, other.covariance)
        assert_array_equal([one.time_s, one.temperature_C], [other.time_s, other.temperature_C])
    assert_array_equal(found.recursion.moments.second, state.recursion.moments.second)
    assert_array_equal(found.recursion.moments.fourth, state.recursion.moments.fourth)


@pytest.mark.parametrize("damage", ["cut", "none", "others", "nan", "flipped"])
def test_what_is_damaged_or_of_another_array_is_told_in_one_sentence(state, tmp_path, damage):
    """Cut, none, of another number of sensors, with a value that is not finite, or with a bit that flipped."""
    path = tmp_path / "samples.live"
    if damage == "nan":
        broken = replace(state.recursion.moments, second=np.full((13, 13), np.nan))
        state = replace(state, recursion=replace(state.recursion, moments=broken))
    write_live_state(path, state, "")
    content = bytearray(path.read_bytes())
    if damage == "cut":
        path.write_bytes(content[: len(content) // 2])
    elif damage == "none":
        path.write_text("nothing")
    elif damage == "flipped":
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
    with pytest.raises(InputError, match=f"^{path} contains nothing that was learned of this array, or is damaged: .+"):
        read_live_state(path, 3 if damage == "others" else 4)


def damaged(content):
    """Yield the content with one byte after another flipped: all of the ends, and one in 297 between."""
    places = sorted({*range(150), *range(0, len(content), 297), *range(len(content) - 150, len(content))})
    for place in places:
        broken = bytearray(content)
        broken[place] ^= 1 << place % 8
        yield bytes(broken)


def test_a_byte_that_is_damaged_is_told(state, tmp_path):
    """Wherever it is, in one sentence: the checksum is over all that follows it."""
    path = tmp_path / "samples.live"
    write_live_state(path, state, "text of it")
    for broken in damaged(path.read_bytes()):
        path.write_bytes(broken)
        with pytest.raises(InputError, match="or is damaged: "):
            read_live_state(path, 4)
