"""What moved is told in sentences: what moved together in one, with its sizes where they are few."""

import numpy as np

from tam_calibration.correction.parts import KINDS, Moved, Update
from tam_calibration.model.data_sheet import ChangeRates
from tam_calibration.report.calibration_rows import update_sentences


def told(*moved):
    """Return the sentences of what moved."""
    table = np.full((4, 12), 0.5)
    return update_sentences(Update("pier.csv", ChangeRates(), 7200.0, None, table, table, 99.0, 30, 0.0, moved))[2:]


def part(kind, sensor, together, rivals=(), since_s=None):
    """Return a change by a hundred times its standard error, which is 1 nT for a bias."""
    return Moved(kind, sensor, np.full(3, 1e-7), np.full(3, 1e-9), 0.9, rivals, since_s, together)


def test_what_moved_alone_has_its_size_and_its_rivals():
    """Since when, too."""
    [sentence] = told(part("bias", 2, None, (("several errors", 2), ("biases", 0)), 12.5))
    assert sentence == (
        "The bias of sensor 2 moved by 100.0 ± 1.0, 100.0 ± 1.0, 100.0 ± 1.0 nT (x y z), at 12.5 s of the recording; "
        "the calibration is that of the sensors since then; with probability 0.10 it was "
        "the several errors of sensor 2 and the biases of all sensors. It was estimated again."
    )


def test_what_moved_together_is_one_sentence():
    """Sizes of up to eight parts are told: two sensors, but not all of an array."""
    biases = [part("bias", sensor, ("biases", 0)) for sensor in range(1, 9)]
    [sentence] = told(*biases)
    assert sentence.startswith("The biases of all sensors moved together: bias of sensor 1 by 100.0 ± 1.0")
    assert sentence.count("bias of sensor") == 8
    [sentence] = told(*biases, part("bias", 9, ("biases", 0)))
    assert sentence == "The biases of all sensors moved. It was estimated again."


def test_what_moved_before_and_within_are_two():
    """Another sensor, and later its bias."""
    whole = [part(kind, 1, ("several errors", 1)) for kind in KINDS]
    first, second = told(*whole, part("bias", 1, None, (), 3.0))
    assert first.startswith("The several errors of sensor 1 moved together: scale factor of sensor 1 by")
    assert second.startswith("The bias of sensor 1 moved by")
