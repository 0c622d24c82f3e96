"""The calibration that is kept up to date with samples as they arrive, and the change of a sensor that they tell."""
