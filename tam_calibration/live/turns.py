"""Information on the sensors from a gyroscope while samples arrive: the turns of two minutes at a time.

A stretch is judged as a recording is (``fit/gyroscope_check``), with what was known before it as prior. Bias, mounting
and delay of the gyroscope are unknown in each stretch and eliminated, so that they may change from one to the next.
"""

from dataclasses import replace

import numpy as np

from tam_calibration.core.interpolation import AveragedRates
from tam_calibration.core.normal_equations import Normal
from tam_calibration.core.slow_cosines import VarianceFactors
from tam_calibration.fit.gyroscope_check import judge_gyroscope
from tam_calibration.fit.prior import Prior
from tam_calibration.fit.problem import Known, Problem
from tam_calibration.live.recursion import Belief
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray


class Stretch:
    """Samples with angular velocity, and what was known before them.

    Parameters
    ----------
    prior : Prior
        Of the sensors; its array states the gyroscope.
    """

    def __init__(self, prior: Prior) -> None:
        self._prior = prior
        self.clear()

    def clear(self) -> None:
        """Begin anew: the sensors have changed, or what there was is learned."""
        self._blocks: list[tuple[FloatArray, FloatArray]] = []
        self._before: Belief | None = None
        self._averaged = AveragedRates()

    def add(self, rows: FloatArray, rates: FloatArray, before: Belief) -> None:
        """Take the samples of a block.

        Parameters
        ----------
        rows : (n, 3K + 3) array
            As of ``Live.add``.
        rates : (n, 3) array
            Angular velocities, rad/s; NaN where there is none.
        before : Belief
            What was known before the block.
        """
        if not np.isfinite(rates).any():
            return
        if self._blocks and rows[0, 0] <= self._blocks[-1][0][-1, 0]:  # the clock was set
            self.clear()
        self._before = self._before or before
        stamps_ns = np.round(1e9 * rows[:, 0]).astype(np.int64)
        self._averaged.add(stamps_ns, rates)
        # Samples that are kept of a block of 2 s; angular velocities are averaged between them, so that none is
        # lost.
        kept = np.linspace(0, len(rows), min(20, len(rows)) + 1).astype(int)[1:] - 1
        self._blocks.append((rows[kept], self._averaged.means(stamps_ns[kept], rates[kept])))

    @property
    def is_full(self) -> bool:
        """Whether it is long enough to be learned."""
        # Time after which what the gyroscope tells is learned: longer than swings in waves take, and than a
        # quarter turn.
        return bool(self._blocks) and self._blocks[-1][0][-1, 0] - self._blocks[0][0][0, 0] >= 120.0

    def information(self, factors: VarianceFactors) -> tuple[Normal, SensorErrors] | None:
        """Return the information of its turns on the errors, and at which; None if the gyroscope is not used.

        Parameters
        ----------
        factors : VarianceFactors
            Of the readings.
        """
        assert self._before is not None
        rows, rates = (np.concatenate(each) for each in zip(*self._blocks, strict=True))
        before, scalar_T = self._before, rows[:, -2]
        calibration = replace(self._prior.calibration, errors=before.errors)
        known = Known(
            replace(self._prior, calibration=calibration, covariance=before.covariance), variance_factors=factors
        )
        self.clear()
        recording = Recording(
            rows[:, 0],
            rows[:, 1:-2].reshape(len(rows), -1, 3),
            scalar_T if np.isfinite(scalar_T).any() else None,
            angular_velocity_rad_s=rates,
        )
        recording, judged = judge_gyroscope(recording, calibration.array, known)
        if judged.fit is None:
            return None
        known = replace(known, gyroscope=judged.fit.begun, start=judged.fit.place)
        problem = Problem.of(recording, calibration.array, known)
        return problem.errors_by_motion(problem.start), problem.start.errors
