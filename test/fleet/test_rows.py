"""What a batch says of all its recordings: laws that come again, by platform."""

import pytest

from tam_calibration.fleet.summary import law_points
from tam_calibration.fleet.task import Result, _law_in_short


def of(platform, *laws, begins_s=1.77e9):
    """Return the result of a recording whose gap has some laws."""
    span = (begins_s, begins_s + 60)
    return Result(
        "dive", platform, "/dive", "done", {}, "0f", time_span_s=span, gap={"verdict": "explained", "laws": laws}
    )


def test_a_law_that_comes_again_is_counted_with_its_first_day():
    """The most frequent first, each platform by itself."""
    drift = "sensor 2: offset following temperature"
    results = [of("vehicle_4", drift), of("vehicle_4", drift, "sensor 1: noise changing at random", begins_s=1.8e9)]
    assert law_points([*results, of("vehicle_5", drift)]) == [
        "vehicle_4, sensor 2: offset following temperature: 2 recordings, since 2026-02-02",
        "vehicle_4, sensor 1: noise changing at random: 1 recording, since 2027-01-15",
        "vehicle_5, sensor 2: offset following temperature: 1 recording, since 2026-02-02",
    ]
    assert law_points([of("auv", drift, begins_s=0.0)]) == [f"auv, {drift}: 1 recording"]  # without a date
    assert law_points([Result("dive", "auv", "/dive", "refused", {}, "0f")]) == []


@pytest.mark.parametrize(
    ("law", "course", "sensors", "follows", "words"),
    [
        ("offset", "channel", [2], "temperature", "sensor 2: offset following temperature"),
        ("own_field", "motion", [1, 3], "motion", "sensors 1 and 3: own field going with the motion"),
        ("offset", "tone", ["scalar"], "2.5 Hz", "the scalar: offset following 2.5 Hz"),
        ("samples", "random", [3], None, "sensor 3: samples changing at random"),
    ],
)
def test_a_law_has_the_same_words_in_every_recording(law, course, sensors, follows, words):
    """Without sizes and times, which differ."""
    assert _law_in_short({"law": law, "course": course, "sensors": sensors, "follows": follows}) == words
