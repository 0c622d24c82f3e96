"""Many recordings through calibration, diagnosis and correction: on the cores of this machine or on a cluster."""
