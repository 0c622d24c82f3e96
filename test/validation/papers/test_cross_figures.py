"""The simulated figures of the papers of crosses, drawn again."""

import numpy as np
import pytest
from numpy.linalg import norm
from numpy.testing import assert_allclose

from tam_calibration.model.units import to_nanotesla
from tam_calibration.validation.papers import PAPERS, chi2017, li2018b
from tam_calibration.validation.papers.cross_figures import redraw
from tam_calibration.validation.papers.not_compared import DRAWN_AGAIN, not_compared


@pytest.mark.parametrize("paper", PAPERS)
def test_every_simulated_figure_is_drawn(paper):
    """Those that the list of what is not compared says to be drawn again, and no other; those of Wu 2025 are sweeps."""
    listed = [item.item.split(",")[0] for item in not_compared(paper) if item.reason.startswith(DRAWN_AGAIN)]
    assert [caption.split(":")[0] for caption in redraw(paper)] == listed


def test_curves_are_the_intensities_of_the_stages():
    """A panel for each stage of the calibration, a line for each sensor."""
    case = chi2017.set_up()
    panels = redraw("chi2017")["Fig. 4: intensities of the sensors"].axes
    for axes, fields in zip(panels, chi2017.stages(case).values(), strict=True):
        drawn = np.array([line.get_ydata() for line in axes.lines]).T
        assert_allclose(drawn, to_nanotesla(norm(fields, axis=2)), rtol=1e-12)


@pytest.mark.parametrize("paper", [chi2017, li2018b])
def test_each_stage_leaves_less_tensor(paper):
    """Before, after the calibration of each sensor, and after the alignment."""
    case = paper.set_up()
    stages = paper.stages(case)
    before, *_, calibrated, aligned = (norm(case.tensor_rms_T_per_m(fields)) for fields in stages.values())
    assert before > calibrated > 100 * aligned
