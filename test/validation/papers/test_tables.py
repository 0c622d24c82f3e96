"""Reproduced numbers as cells."""

import math
from dataclasses import replace

from tam_validation.papers.row import PaperNumber
from tam_validation.papers.tables import cells, notes, tally

ROWS = [
    PaperNumber("Table 1, TMI", 6685.23, 6685.1912, "nT", "reproduced"),
    PaperNumber(
        "Table 1, ψ",
        0.025,
        -0.025,
        "rad",
        "paper in error",
        "a sign",
        "paper in error",
        "printed",
        -0.025,
        "theory",
    ),
    PaperNumber("Fig. 4, bias", 1, 0.99961, "exponent", "reproduced", "the noise", source="said in words"),
    PaperNumber("Fig. 9, e_T", -1, -1, "sign", "reproduced", "a sign"),
    PaperNumber("Table 2, θ", 0.5, math.nan, "°", "not reproduced", "measured", "not reproduced"),
    PaperNumber("Fig. 5, e_B", 0, -0.0001, "exponent", "reproduced"),
]


def test_cells_are_for_people():
    """Numbers have the digits they are worth, and a reason that several share is one note."""
    assert notes(ROWS) == ["a sign", "the noise", "measured"]
    assert cells(ROWS) == [
        ["Table 1, TMI", "6685.23", "printed", "6685.191", "nT", "1.0000", "reproduced", "", ""],
        ["Table 1, ψ", "0.025", "printed", "−0.025", "rad", "−1.0000", "paper in error", "−0.025, theory", "1"],
        ["Fig. 4, bias", "1", "said in words", "1.000", "exponent", "0.9996", "reproduced", "", "2"],
        ["Fig. 9, e_T", "−1", "printed", "−1", "sign", "1.0000", "reproduced", "", "1"],
        ["Table 2, θ", "0.5", "printed", "–", "°", "–", "not reproduced", "", "3"],
        ["Fig. 5, e_B", "0", "printed", "0.000", "exponent", "–", "reproduced", "", ""],
    ]
    assert tally(ROWS) == [4, 1, 1]


def test_another_status_than_on_record_is_told_at_its_row():
    """A regression is seen at once."""
    (texts,) = cells([replace(ROWS[0], status="not reproduced")])
    assert texts[6] == "not reproduced, recorded as reproduced"
