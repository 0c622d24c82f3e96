"""What speaks for an effect that was found."""

import numpy as np


def evidence(finding, residuals):
    """Return how much BIC speaks for a finding."""
    return finding.gain - finding.parameter_count * np.log(residuals.channel_count.sum())
