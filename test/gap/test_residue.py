"""The residual of every row and sample is that of the model, and the twin's is noise."""

import numpy as np
import pytest

from tam_calibration.gap.conclude import residue_of


def test_what_was_planted_is_in_its_row_and_not_in_the_twin(run):
    """Before the causes; the twin has noise of the stated size alone."""
    made = run(700)
    drift = 20e-9 * np.sin(2 * np.pi * made.recording.time_s / 18)
    model = made.with_row(4, drift).model()
    residue = residue_of(model, model, model.channels(), 1.0)
    assert np.corrcoef(residue.before[:, 4], drift)[0, 1] > 0.95
    assert abs(np.corrcoef(residue.twin[:, 4], drift)[0, 1]) < 0.2
    assert np.std(residue.twin[:, 4]) == pytest.approx(residue.floor_T[4], rel=0.1)
