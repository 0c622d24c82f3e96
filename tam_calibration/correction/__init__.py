"""A calibration, and the correction of recordings and of samples as they arrive."""
