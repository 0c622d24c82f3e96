"""The usage: how many of sensor 1's samples were used, why not the others, and when that is too few."""

import pytest

from tam_calibration.messages.point_cloud import SampleLayout
from tam_calibration.messages.synchroniser import Synchroniser
from tam_calibration.messages.usage import Usage
from tam_calibration.model.exceptions import Refused

MS = 1_000_000
PERIOD = 10 * MS
START = 10**18


def usage_of(messages, sensor_count=2):
    """Return the usage of (stream, stamp) messages of sensors."""
    synchroniser = Synchroniser(SampleLayout(sensor_count), MS)
    for stream, stamp_ns in messages:
        synchroniser.push(stream, stamp_ns, (0.0, 0.0, 0.0))
    return synchroniser.usage


def pairs(count, late_ns=0, lost=()):
    """Return messages of two sensors, the second with other stamps or missing."""
    messages = []
    for index in range(count):
        messages.append(("tam_1", START + index * PERIOD))
        if index not in lost:
            messages.append(("tam_2", START + index * PERIOD + late_ns))
    return messages


def test_all_samples_are_used():
    """Nothing is missing, nothing is told; what waits for its partners does not count."""
    assert usage_of(pairs(100)) == Usage(100, 100)
    assert usage_of([*pairs(100), ("tam_1", START + 100 * PERIOD)]) == Usage(100, 100)
    assert str(Usage(100, 100)) == "100 of 100 samples of sensor 1 used"
    assert Usage(100, 100).warnings() == Usage(0, 0).warnings() == ()


@pytest.mark.parametrize(("late_s", "behind"), [(-1, "tam_2"), (1, "tam_3")])
def test_clocks_that_differ_are_refused_with_the_parameter(late_s, behind):
    """A sensor that lags by more than the patience, also where it is another that runs ahead."""
    messages = [message for message in pairs(200, late_ns=late_s * 1000 * MS) for message in around(message)]
    with pytest.raises(
        Refused, match=rf"only \d+ of \d+ samples of sensor 1 used: \d+ found none of {behind}, whose"
    ) as why:
        usage_of(messages, 3).warnings()
    ahead = "tam_1" if behind == "tam_2" else "tam_2"
    assert f"newest stamp is 1 s behind that of {ahead}" in str(why.value) and "delay_s in the array file" in str(
        why.value
    )


def around(message):
    """Return a message, and for one of sensor 1 that of sensor 3, which comes a little later."""
    name, stamp_ns = message
    return [message, ("tam_3", stamp_ns)] if name == "tam_1" else [message]


@pytest.mark.parametrize(("lost", "warns"), [(9, False), (20, True)])
def test_gaps_are_a_warning_below_nine_tenths(lost, warns):
    """A tenth may be lost without a warning; the count and the sensor are told always."""
    usage = usage_of(pairs(100, lost=range(10, 10 + lost)))
    assert (usage.used, usage.received) == (100 - lost, 100)
    reason = f"{lost} found none of tam_2, of which {100 - lost} messages came: they have gaps, or come too late"
    assert str(usage) == f"{100 - lost} of 100 samples of sensor 1 used: {reason}; look at the load"
    assert usage.warnings() == ((f"only {usage}",) if warns else ())


def test_a_silent_sensor_is_named():
    """Of three sensors the third never sends: it is the cause, not the second."""
    messages = [(f"tam_{sensor}", index * PERIOD) for index in range(100) for sensor in (1, 2)]
    with pytest.raises(Refused, match="used: nothing arrived from tam_3: check sensor, cable, driver and topic; mend"):
        usage_of(messages, 3).warnings()


def test_false_stamps_are_named():
    """Of sensor 1 as its own fault; another sensor is interpolated over its own."""

    def false(sensor):
        return [(name, 0 if name == sensor and stamp % (3 * PERIOD) == 0 else stamp) for name, stamp in pairs(100)]

    (warning,) = usage_of(false("tam_1")).warnings()
    assert warning == "only 67 of 100 samples of sensor 1 used: 33 have false stamps: look at the driver of tam_1"
    assert usage_of(false("tam_2")).used > 95


def test_a_sensor_of_unusable_messages_is_named():
    """The counts say what is wrong with them."""
    synchroniser = Synchroniser(SampleLayout(2), MS)
    for name, stamp_ns in pairs(100):
        if name == "tam_1":
            synchroniser.push(name, stamp_ns, (0.0, 0.0, 0.0))
        else:
            synchroniser.refuse(name)
    with pytest.raises(
        Refused, match=r"found none of tam_2, most of whose messages cannot be used: .*100 messages unus"
    ):
        synchroniser.usage.warnings()


def test_a_usage_goes_to_other_processes():
    """As text, without a loss."""
    usage = Usage(5, 7, ("one", "zwölf"))
    assert Usage.from_json(usage.to_json()) == usage
