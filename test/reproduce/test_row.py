import math

from tam_calibration.reproduce.row import Row, compare, correct_paper


def test_a_number_within_its_tolerance_is_reproduced():
    """The larger of the two tolerances counts, and a reason stands only where something is to be explained."""
    rows = compare(["a", "b"], [100.0, 100.0], [100.9, 102.0], "nT", relative=0.01, absolute=0.5, reason="why")
    assert [row.status for row in rows] == ["reproduced", "not reproduced"]
    assert [row.reason for row in rows] == ["", "why"]


def test_the_ratio_is_ours_by_the_papers():
    """A number that the paper has as zero has no finite ratio."""
    assert Row("a", 2.0, 3.0, "nT", "not reproduced").ratio == 1.5
    assert math.isinf(correct_paper(["a"], [0.0], [1.0], "°", "why")[0].ratio)
