"""Interference at a fixed frequency."""

from collections.abc import Iterable

import numpy as np

from tam_calibration.effects.effect import Covariates, FittedEffect, LinearEffect, Shape, Sized
from tam_calibration.effects.grades import NEGLIGIBLE
from tam_calibration.effects.laws import course_terms
from tam_calibration.effects.term import Term, WhitenedResiduals
from tam_calibration.model.units import FloatArray

_LEAST_PERIODS = 10
"""Periods in the record at least: slower variation is a drift."""

_MOST_STEPS = 1 << 21
"""Steps of time that a transform spans, of some hundred megabytes."""

_FINER = 4
"""Points of the periodogram per width of a line."""


class PeriodicInterference(LinearEffect):
    """A sinusoid of one frequency with its harmonics; above half the sampling rate it shows at its alias."""

    name = "periodic_interference"

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that the recording is too short, where it is."""
        if covariates.sample_count <= 2 * _LEAST_PERIODS:
            return f"{covariates.sample_count} samples are too few for a spectrum"
        return None

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return the frequencies of the strongest lines above the band of drifts; none of a record too long.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        residuals : WhitenedResiduals
            Of the same N samples.
        """
        span_s = float(np.ptp(covariates.time_s))
        if covariates.sample_count <= 2 * _LEAST_PERIODS or span_s > _MOST_STEPS * covariates.step_s:
            return []
        start = float(covariates.time_s[0])
        return [{"frequency_hz": frequency, "start_s": start} for frequency in _lines(residuals)]

    def is_same(self, shape: Shape, other: Shape, covariates: Covariates) -> bool:
        """Whether two frequencies lie within the width of a line: a tone that trembles is one.

        Parameters
        ----------
        shape, other : Shape
            Each with ``frequency_hz``, hertz.
        covariates : Covariates
            Their times state the duration, hence the width of a line.
        """
        apart = abs(shape["frequency_hz"] - other["frequency_hz"])
        return apart * float(np.ptp(covariates.time_s)) < 4.0

    def sizes(self, covariates: Covariates, fitted: FittedEffect) -> list[Sized]:
        """Return the amplitudes, and that of the harmonics beside that of the line.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        fitted : FittedEffect
            Amplitudes of the line and its harmonics.
        """
        squares = {"line": 0.0, "harmonics": 0.0}
        for one in fitted.contributions:
            squares[one.term] += sum(value**2 for value in one.values.values())
        with np.errstate(over="ignore"):  # beside a line of nothing its harmonics are beyond any limit
            ratio = float(np.sqrt(squares["harmonics"]) / max(np.sqrt(squares["line"]), np.finfo(float).tiny))
        overtones = "harmonics over the line"
        return [*super().sizes(covariates, fitted), Sized(overtones, ratio, self.limits[overtones])]

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return cosine and sine on each row, and those of the second and third harmonic.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        shape : Shape
            ``frequency_hz``, hertz, and ``start_s``, the time of phase zero, seconds.
        """
        phase = 2 * np.pi * shape["frequency_hz"] * (covariates.time_s - shape["start_s"])
        terms = []
        for name, orders in (("line", (1,)), ("harmonics", (2, 3))):
            waves = np.column_stack([wave(order * phase) for order in orders for wave in (np.cos, np.sin)])
            units = {f"{wave} {order}": "T" for order in orders for wave in ("cosine", "sine")}
            terms += course_terms(covariates, name, units, waves, with_scalar=True)
        return terms


def _lines(residuals: WhitenedResiduals) -> list[float]:
    """Return the frequencies, hertz, at which one row alone has the strongest lines."""
    covariates = residuals.covariates
    information = residuals.row_information * residuals.is_counted[:, None]
    score = residuals.row_shift_T * information
    size = information.sum(axis=0)
    score = score[:, size > 0] / np.sqrt(size[size > 0])
    if not score.shape[1]:
        return []
    time = covariates.time_s - covariates.time_s[0]
    index, spacing = _lattice(time, covariates.step_s)
    length = _FINER * int(index[-1] + 1)
    power = np.zeros(length // 2 + 1)
    row_of = np.zeros(len(power), dtype=int)
    for row, own in enumerate(score.T):
        on_lattice = np.bincount(index, own, minlength=length)
        of_row = np.abs(np.fft.rfft(on_lattice)) ** 2
        row_of[of_row > power] = row
        power = np.maximum(power, of_row)
    frequency = np.arange(len(power)) / (length * spacing)
    power[(frequency <= _LEAST_PERIODS / time[-1]) | (frequency >= 0.5 / covariates.step_s)] = 0
    found: list[float] = []
    while len(found) < 4 and power.max() > 0:
        best = int(power.argmax())
        found.append(_refined(score[:, row_of[best]], time, float(frequency[best]), float(frequency[1])))
        power[max(best - 3 * _FINER, 0) : best + 3 * _FINER + 1] = 0
    return found


def _lattice(time: FloatArray, step: float) -> tuple[FloatArray, float]:
    """Return the place (N,) of each sample on a lattice of times, and its spacing."""
    mean = (time[-1] / max(round(time[-1] / step), 1)) or step
    place = time / mean
    if np.abs(place - np.rint(place)).max() < NEGLIGIBLE:
        return np.rint(place).astype(int), mean
    # Samples that lie on no lattice of their own get four points per step, and at most 16 per sample.
    spacing = max(step / 4, time[-1] / (16 * len(time)))
    return np.rint(time / spacing).astype(int), spacing


def _refined(score: FloatArray, time: FloatArray, frequency: float, width: float) -> float:
    """Return the frequency of the top of a line, by parabolas through the power at three frequencies."""
    for _ in range(3):  # parabolas, each of a quarter of the width
        power = [
            np.abs(np.exp(-2j * np.pi * (frequency + offset) * time) @ score) ** 2 for offset in (-width, 0, width)
        ]
        bend = power[0] - 2 * power[1] + power[2]
        if bend >= 0:
            break
        frequency += width * float(np.clip((power[0] - power[2]) / (2 * bend), -1, 1))
        width /= 4
    return frequency
