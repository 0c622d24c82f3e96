"""The rows of `source_estimate`."""

import numpy as np

from tam_calibration.localization.solutions import EulerSolutions
from tam_calibration.units import FloatArray


def source_rows(solutions: EulerSolutions) -> FloatArray:
    """Return solutions as the (N, 19) rows of ``pointcloud_layout.SOURCE_COLUMNS``."""
    row, column = np.triu_indices(3)
    parts = (
        solutions.position_m,
        solutions.position_covariance_m2[:, row, column],
        solutions.moment_Am2,
        solutions.moment_covariance_A2m4[:, row, column],
        solutions.status[:, None],
    )
    return np.concatenate(parts, axis=1)
