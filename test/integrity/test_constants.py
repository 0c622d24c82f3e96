"""The constants of the channel checks: each as large as its reason says."""

import pytest

from tam_calibration.integrity import check, fault, placement, repeated, values

STATED = {
    check: {"_SCREENED": ("frozen", "unit", "zero")},
    fault: {"SHARED": 0.9},
    repeated: {
        **{"SHORTEST": 10, "PROBES": 16, "COPIED": 1 - 1e-13},
        **{"FINE": 0.1, "MOVED": 0.1, "STEPS": 2, "SAME": 0.8},
    },
    placement: {
        **{"NEAR": 0.8, "FITS": 0.1, "ROUNDING": 0.005, "TILT": 0.1, "FEWEST": 30},
        **{"LEVEL": 0.05, "UNEXPLAINED": 0.02},
    },
    values: {
        **{"APART": 30, "TURNED": 0.02},
        **{"FEWEST_AT_END": 6, "MANY_AT_END": 0.01, "COARSE": 10},
        **{"CELLS": 2048, "FEWEST_PERIODS": 2.5, "DIFFERENT": 100, "COHERENT": 0.5},
        **{"EMPTY": (0.45, 0.8), "FILLED": 7, "NEAR": 160},
    },
}


@pytest.mark.parametrize("module", STATED, ids=lambda module: module.__name__.rpartition(".")[2])
def test_constants(module):
    """None is changed by chance, none is new without a line here."""
    own = {
        name: value for name, value in vars(module).items() if name.isupper() and isinstance(value, int | float | tuple)
    }
    imported = {"SKETCH", "MOST_NAMED", "FEWEST_SAMPLES"} | ({"SHARED"} if module is not fault else set())
    assert {name: value for name, value in own.items() if name not in imported} == STATED[module]
