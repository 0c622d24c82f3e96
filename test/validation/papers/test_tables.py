"""Reproduced numbers as cells."""

import math

import numpy as np

from tam_validation.papers.row import PaperNumber
from tam_validation.papers.tables import cells, notes, tally

ROWS = [
    PaperNumber("Table 1, TMI", "nT", 6685.23, np.array([6685.1, 6685.1912, 6685.3])),
    PaperNumber(
        "Table 1, ψ", "rad", 0.025, -np.array([0.0251, 0.025, 0.0249]), 0.0, "printed", "a sign", -0.025, "theory"
    ),
    PaperNumber("Fig. 9, e_T", "1", -1, np.array([0.0, -0.0]), source="said in words", note="the noise"),
    PaperNumber("Table 2, θ", "°", 0.5, np.full(2, math.nan), note="a sign"),
]


def test_cells_are_for_people():
    """Numbers have the digits they are worth, and a note that several share has one number."""
    assert notes(ROWS) == ["a sign", "the noise"]
    assert cells(ROWS) == [
        ["Table 1, TMI", "6685.23", "printed", "6685.191", "6685.1 to 6685.3", "nT", "reproduced", "", ""],
        [
            "Table 1, ψ",
            "0.025",
            "printed",
            "−0.025",
            "−0.0251 to −0.0249",
            "rad",
            "paper in error",
            "−0.025, theory",
            "1",
        ],
        ["Fig. 9, e_T", "−1", "said in words", "0", "0 to 0", "", "not reproduced", "", "2"],
        ["Table 2, θ", "0.5", "printed", "–", "– to –", "°", "not reproduced", "", "1"],
    ]
    assert tally(ROWS) == [1, 2, 1]
