"""Timing jitter: a sensor whose true times of sampling scatter at random about its stamps.

A reading at t + δ differs by δ M db/dt: white noise with a variance for each sample, along the path of the field and
growing with the square of its rate.
"""

import numpy as np

from tam_calibration.effects.effect import Covariates, Finding, FoundEffect, WhitenedResiduals
from tam_calibration.effects.motion import jumps, rates
from tam_calibration.effects.spread import Spread
from tam_calibration.effects.term import rows_of
from tam_calibration.model.fitted_effect import Contribution, FittedEffect
from tam_calibration.model.units import FloatArray


class TimingJitter(FoundEffect):
    """A scatter of the true times of sampling of one sensor."""

    name = "timing_jitter"

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that there is no continuous motion, or no other sensor to tell it, where that is so."""
        if covariates.sensor_count == 1:
            return "one sensor alone does not tell how fast the field changed when it was read"
        return jumps(covariates)

    def find(self, residuals: WhitenedResiduals) -> Finding | str:
        """Return the sensor whose samples scatter along the path of the field and by how much, or why none does."""
        rate = _rates_of_rows(residuals.covariates)
        rows = [slice(3 * sensor, 3 * sensor + 3) for sensor in range(residuals.covariates.sensor_count)]
        found = [Spread.of(residuals, range(own.start, own.stop), rate[:, own, None]) for own in rows]
        sensor = int(np.argmax([one.gain for one in found]))
        best = found[sensor]
        if best.gain <= 0:
            return "no sensor scatters along the path of the field"
        spread = np.zeros((len(rate), rate.shape[1] + 1))
        spread[:, rows[sensor]] = best.size * rate[:, rows[sensor]]
        values = {"standard deviation": best.size}
        errors = {"standard deviation": best.size * best.relative_error}
        # Jitter has two numbers: its size, and the sensor.
        return Finding(
            FittedEffect(self.name, {}, (Contribution(sensor, None, "jitter", values, errors),)),
            gain=best.gain,
            parameter_count=2,
            spread_T=spread,
        )

    def put(self, rows_T: FloatArray, part: Contribution, run: Covariates, source: np.random.Generator) -> FloatArray:
        """Return the readings (N, n) of the n rows that a contribution acts on with the effect; see `FoundEffect`."""
        early = source.normal(0, part.values["standard deviation"], (len(rows_T), 1))
        return rows_T + early * _rates_of_rows(run)[:, rows_of(part, run)]


def _rates_of_rows(covariates: Covariates) -> FloatArray:
    """Return the rate (N, 3K) of what each axis senses, T/s."""
    return rates(covariates) @ covariates.errors.matrix.reshape(-1, 3).T
