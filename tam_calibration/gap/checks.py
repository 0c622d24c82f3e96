"""Predictive checks: whether the residual of a diagnosis looks like noise, by statistics of each row.

The residual of a simulated twin is white and normal, so that the range of each statistic follows from the number of
samples n: χ²/n that of χ²; the lag-1 correlation -1/n ± z/√n (Bartlett, J. R. Stat. Soc. B 8, 1946); the strongest line
of the periodogram over its mean (Fisher, Proc. R. Soc. A 125, 1929); the part of the variance that spherical harmonics
of the direction explain a beta law; the kurtosis that of Anscombe and Glynn (Biometrika 70, 1983).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.harmonics import harmonics
from tam_calibration.effects.grades import LEAST_SAMPLES, SLIGHT
from tam_calibration.model.recording import InterpolatedNoise
from tam_calibration.model.units import FloatArray

LAGS = 20
"""Samples up to which the autocorrelation is given."""


_SAYS = {
    "chi_square": (
        "is larger than noise",
        "is smaller than noise",
        "χ²/n {value:.3g}, where noise has {low:.2f} to {high:.2f}",
    ),
    "lag_1_correlation": (
        "is correlated from sample to sample",
        "changes its sign from sample to sample",
        "lag-1 correlation {value:.2f}, where noise has {middle:.2f} ± {half:.2f}",
    ),
    "strongest_line": (
        "has a line in its spectrum",
        "",
        "at {line_hz:.3g} Hz {value:.0f} times the mean power, where noise has up to {high:.0f} times",
    ),
    "part_of_direction": (
        "goes with the direction of the field",
        "",
        "{percent:.2g} % of its variance does, where of noise up to {percent_high:.2g} % does",
    ),
    "excess_kurtosis": (
        "has far outliers",
        "has shorter tails than noise",
        "excess kurtosis {value:.2f}, where noise has {low:.2f} to {high:.2f}",
    ),
}
"""Words for a statistic above and below the range of noise, and its figures."""


@dataclass(frozen=True, eq=False)
class Check:
    """One statistic of each row (R,), and its range in noise; NaN for a row without enough samples."""

    values: FloatArray
    low: FloatArray
    high: FloatArray

    @property
    def departs(self) -> NDArray[np.bool_]:
        """(R,) whether the statistic is out of its range in noise."""
        return (self.values < self.low) | (self.values > self.high)

    @property
    def worst(self) -> int:
        """The row that is farthest out of its range, in widths of the range."""
        out = np.maximum(self.low - self.values, self.values - self.high) / (self.high - self.low)
        return int(np.nanargmax(out))


@dataclass(frozen=True, eq=False)
class Checks:
    """Statistics of the residual with its causes, by row.

    Parameters
    ----------
    by_name : mapping of str to Check
        ``chi_square``: mean square over that of the noise floor. ``lag_1_correlation``: of neighbouring samples.
        ``strongest_line``: largest power of the periodogram over its mean. ``part_of_direction``: part of the variance
        that goes with the direction of the field. ``excess_kurtosis``: fourth moment over the squared second, less 3.
    line_hz : (R,) array
        Frequency of the strongest line.
    autocorrelation : (R, LAGS) array
        From lag 1 on.
    """

    by_name: Mapping[str, Check]
    line_hz: FloatArray
    autocorrelation: FloatArray

    @property
    def departures(self) -> int:
        """The number of statistics that are out of their range in any row."""
        return sum(bool(check.departs.any()) for check in self.by_name.values())

    @property
    def sentences(self) -> tuple[str, ...]:
        """What departs from the twin, one sentence for each statistic, of the row in which it does so most."""
        sentences = []
        for statistic, check in self.by_name.items():
            departs = check.departs
            if not departs.any():
                continue
            row, others = check.worst, int(departs.sum()) - 1
            value, low, high = (float(each[row]) for each in (check.values, check.low, check.high))
            above, below, figures = _SAYS[statistic]
            details = figures.format(
                value=value,
                low=low,
                high=high,
                middle=round((low + high) / 2, 2) + 0.0,
                half=(high - low) / 2,
                line_hz=self.line_hz[row],
                percent=100 * value,
                percent_high=100 * high,
            ).replace(" -", " −")
            also = f" (axes alike: {others} more)" if others else ""
            says = f"{above if value > high else below}: {details}{also}"
            axis = f"sensor {row // 3 + 1} {'xyz'[row % 3]}"
            name = "the scalar magnetometer" if row == len(departs) - 1 else axis
            sentences.append(f"The residual of {name} {says}.")
        return tuple(sentences)


def checks_of(
    time_s: FloatArray,
    direction: FloatArray,
    rows_T: FloatArray,
    floor_T: FloatArray,
    interpolated: InterpolatedNoise | None = None,
) -> Checks:
    """Return the statistics of a residual.

    Parameters
    ----------
    time_s : (N,) array
        Time stamps.
    direction : (N, 3) array
        Of the field in the array frame.
    rows_T : (N, R) array
        Residual of each row, tesla; NaN where a sample has no information on it.
    floor_T : (R,) array
        Its standard deviation from noise alone.
    interpolated : InterpolatedNoise, optional
        What interpolation made of the noise of the sensors, which rows may have in part.
    """
    # A calibration absorbs spherical harmonics of degree 1 and 2, nonlinear axes have 3.
    functions = harmonics(direction, 3)[:, 1:]
    row_count = rows_T.shape[1]
    chance = 1 - (1 - SLIGHT) ** (1 / (5 * row_count))
    step_s = float(np.median(np.diff(time_s)))
    checked = np.full((5, 3, row_count), np.nan)
    line_hz, correlation = np.full(row_count, np.nan), np.full((row_count, LAGS), np.nan)
    for row in range(row_count):
        values = rows_T[:, row] / (floor_T[row] or np.nan)
        known = np.isfinite(values)
        if known.sum() < 2 * LEAST_SAMPLES or not np.ptp(values[known]):
            continue
        correlation[row] = _autocorrelation(values, known)
        line, cycles = _strongest_line(values, known, chance)
        line_hz[row] = cycles / step_s
        checked[:, :, row] = (
            _chi_square(values[known], chance),
            _lag_1(float(correlation[row, 0]), int(known.sum()), chance),
            line,
            _part_of_direction(values[known], functions[known], chance),
            _kurtosis(values[known], chance),
        )
    if interpolated is not None:
        shared = interpolated.correlation[:, 0]
        checked[1, 1:] += np.array([min(shared.min(), 0.0), max(shared.max(), 0.0)])[:, None]
        checked[2, 2] *= interpolated.spectrum(np.linspace(0, 0.5, LAGS)).max()
    return Checks({name: Check(*each) for name, each in zip(_SAYS, checked, strict=True)}, line_hz, correlation)


_Checked = tuple[float, float, float]
"""A statistic of one row, and its range in noise."""


def _chi_square(values: FloatArray, chance: float) -> _Checked:
    from scipy.special import chdtri

    count = len(values)
    low, high = chdtri(count, [1 - chance / 2, chance / 2]) / count
    return float(np.mean(values**2)), float(low), float(high)


def _autocorrelation(values: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    """Return the correlations (LAGS,) of samples that are so many apart, over the pairs that are both known."""
    centred = np.where(known, values - values[known].mean(), 0.0)
    pairs = np.array([np.sum(known[lag:] & known[:-lag]) for lag in range(1, LAGS + 1)])
    products = np.array([centred[lag:] @ centred[:-lag] for lag in range(1, LAGS + 1)])
    return np.asarray(products / np.maximum(pairs, 1) / (np.sum(centred**2) / known.sum()))


def _lag_1(value: float, count: int, chance: float) -> _Checked:
    from scipy.special import ndtri

    half = -float(ndtri(chance / 2)) / count**0.5
    return value, -1 / count - half, -1 / count + half


def _strongest_line(values: FloatArray, known: NDArray[np.bool_], chance: float) -> tuple[_Checked, float]:
    """Return the check of the periodogram, and the frequency of its largest ordinate in cycles a sample."""
    centred = np.where(known, values - values[known].mean(), 0.0)
    power = np.abs(np.fft.rfft(centred)[1 : (len(centred) + 1) // 2]) ** 2
    count = len(power)
    high = count * (1 - (chance / count) ** (1 / (count - 1)))
    strongest = int(np.argmax(power))
    return (float(power[strongest] / power.mean()), 0.0, high), (strongest + 1) / len(centred)


def _part_of_direction(values: FloatArray, functions: FloatArray, chance: float) -> _Checked:
    from scipy.special import betainccinv

    centred, functions = values - values.mean(), functions - functions.mean(axis=0)
    score = functions.T @ centred
    coefficients, _, rank, _ = np.linalg.lstsq(functions.T @ functions, score, rcond=1e-9)
    high = betainccinv(rank / 2, (len(values) - 1 - rank) / 2, chance) if rank else 0.0
    return float(score @ coefficients / np.sum(centred**2)), 0.0, float(high)


def _kurtosis(values: FloatArray, chance: float) -> _Checked:
    from scipy.special import ndtri

    count = len(values)
    middle = 3 * (count - 1) / (count + 1)
    deviation = np.sqrt(24 * count * (count - 2) * (count - 3) / ((count + 1) ** 2 * (count + 3) * (count + 5)))
    skew = 6 * (count**2 - 5 * count + 2) / ((count + 7) * (count + 9))
    skew *= np.sqrt(6 * (count + 3) * (count + 5) / (count * (count - 2) * (count - 3)))
    freedom = 6 + 8 / skew * (2 / skew + np.sqrt(1 + 4 / skew**2))
    spread = 2 / (9 * freedom)

    def quantile(part: float) -> float:
        root = 1 - spread - float(ndtri(part)) * spread**0.5
        scaled = ((1 - 2 / freedom) / root**3 - 1) / np.sqrt(2 / (freedom - 4))
        return float(middle + deviation * scaled - 3)

    low, high = quantile(chance / 2), quantile(1 - chance / 2)
    centred = values - values.mean()
    return float(np.mean(centred**4) / np.mean(centred**2) ** 2 - 3), min(low, high), max(low, high)
