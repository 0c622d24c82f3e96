"""Many recordings through calibration, diagnosis and correction on all cores."""
