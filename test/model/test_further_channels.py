"""Further currents and actuators: a name tells column, topic and unit, and a recording keeps them whatever it does."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import (
    Recording,
    channel_in_words,
    is_further,
    named_by,
    require_further,
    topic_of,
    unit_of,
)

NAMES = {
    "current_2_A": "currents/current_2",
    "current_99_A": "currents/current_99",
    "actuator_rudder": "actuators/rudder",
}


@pytest.mark.parametrize(("name", "topic"), NAMES.items())
def test_a_name_and_its_topic_tell_each_other(name, topic):
    """The column tells the topic, and the topic the column."""
    assert is_further(name)
    assert topic_of(name) == topic
    assert named_by(topic) == name


@pytest.mark.parametrize(
    "name", ["current_A", "current_1_A", "current_02_A", "current_100_A", "rudder", "actuator_Rudder"]
)
def test_other_names_are_none(name):
    """The first current keeps its old name, and whoever names another channel so is told how it is done."""
    assert not is_further(name)
    with pytest.raises(InputError, match="is no further channel: one is named current_2_A"):
        require_further([name])


def test_other_topics_are_none():
    """Also that of the first current."""
    assert [
        named_by(topic) for topic in ("current", "currents/current_1", "currents/current_2/more", "actuators/")
    ] == [None] * 4


def test_units_and_words():
    """A current is in ampere, an actuator in its own unit; sentences name channels of old without unit."""
    assert (unit_of("current_2_A"), unit_of("actuator_rudder")) == ("A", "1")
    assert (channel_in_words("temperature_C"), channel_in_words("current_2_A")) == ("temperature", "current_2_A")


def test_currents_stand_before_actuators_in_the_order_of_their_numbers():
    """However they are given, and even from what can be read once only."""
    given = iter(["actuator_rudder", "current_10_A", "current_2_A", "current_2_A"])
    assert require_further(given) == ("current_2_A", "current_10_A", "actuator_rudder")


def recording(**further):
    """Return four samples of one sensor with further channels."""
    return Recording(np.arange(4.0), np.full((4, 1, 3), 3e-5), further=further)


def test_a_recording_keeps_them_when_samples_are_taken():
    """Those without any value are absent, as other channels are."""
    kept = recording(current_2_A=[1, 2, np.nan, 4], actuator_rudder=np.full(4, np.nan)).take(slice(1, 3))
    assert_array_equal(kept.channel("current_2_A"), [2, np.nan])
    assert list(kept.further) == ["current_2_A"] and kept.channel("actuator_rudder") is None


@pytest.mark.parametrize(
    ("values", "sentence"),
    [(np.ones(3), "current_2_A must have the shape"), ([1, 2, 3, 1e7], "current_2_A in sample 4")],
)
def test_values_that_are_none_are_refused(values, sentence):
    """By name, as those of other channels are."""
    with pytest.raises(InputError, match=sentence):
        recording(current_2_A=values)
