import math

from tam_validation.papers.row import PaperNumber, compare, together


def test_a_number_within_its_tolerance_is_reproduced():
    """The larger of the two tolerances counts, and a reason stands only where something is to be explained."""
    rows = compare(["a", "b"], [100.0, 100.0], [100.9, 102.0], "nT", relative=0.01, absolute=0.5, reason="why")
    assert [row.status for row in rows] == ["reproduced", "not reproduced"]
    assert [row.reason for row in rows] == ["", "why"]


def test_the_ratio_is_ours_by_the_papers():
    """A number that the paper has as zero has no finite ratio."""
    assert PaperNumber("a", 2.0, 3.0, "nT", "not reproduced").ratio == 1.5
    assert math.isinf(PaperNumber("a", 0.0, 1.0, "°", "paper in error").ratio)


def test_the_paper_is_in_error_where_ours_is_right():
    """A number of ours that is not the right one shows as another status than is on record."""
    right, wrong = compare(
        ["a", "b"], [0.0, 0.0], [1.001, 1.1], "°", reason="why", right=[1, 1], right_source="theory", absolute=0.01
    )
    assert (right.status, wrong.status) == ("paper in error", "not reproduced")
    assert right.is_as_recorded
    assert not wrong.is_as_recorded
    assert (right.right, right.right_source, right.source) == (1.0, "theory", "printed")


def test_one_number_that_disagrees_takes_the_others_with_it():
    """Numbers that are one finding have one status."""
    near = compare("ab", [1, 1], [1.05, 1], "1", relative=0.1)
    assert {row.status for row in together(near)} == {"reproduced"}
    far = together(compare("ab", [1, 1], [1.2, 1], "1", relative=0.1, reason="why"))
    assert {(row.status, row.reason) for row in far} == {("not reproduced", "why")}
