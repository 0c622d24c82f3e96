"""The residual that no cause explains, by sample and in words: its size, its place, and what it correlates with."""

from dataclasses import replace

import numpy as np

from tam_calibration.gap.checks import row_name
from tam_calibration.gap.model import Model
from tam_calibration.gap.result import Residue, Size, Verdict, Where
from tam_calibration.gap.search import Search
from tam_calibration.gap.support import LEAST_EVIDENCE
from tam_calibration.gap.where import locate
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.units import FloatArray, to_nanotesla


def residue_of(nominal: Model, model: Model, before: WhitenedChannels, variance: float) -> Residue:
    """Return the residual of each row and sample before the causes, with them, and of a twin with noise alone.

    Parameters
    ----------
    nominal, model : Model
        Before the causes, and with them.
    before : WhitenedChannels
        Of the nominal model, all samples.
    variance : float
        Of the channels' white noise, over that of the array.
    """
    array = nominal.array
    generator = np.random.default_rng(0)
    covariates = before.covariates
    scale = float(np.sqrt(variance))
    noise = generator.normal(size=(covariates.sample_count, covariates.sensor_count, 3)) * (
        scale * nominal.row_noise_T.reshape(-1, 3)
    )
    direction = covariates.field_T / covariates.intensity_T[:, None]
    field_T: FloatArray = nominal.intensity_T * direction
    scalar = None
    if nominal.recording.scalar_T is not None:
        drawn = generator.normal(size=covariates.sample_count) * (scale * (array.scalar_noise_T or 0.0))
        field_T, scalar = covariates.field_T, np.where(before.precision > 0, covariates.intensity_T + drawn, np.nan)
    readings = covariates.errors.distort(field_T) + noise
    twin = WhitenedChannels.at(
        replace(nominal.recording, readings_T=readings, scalar_T=scalar),
        array,
        nominal.errors,
        nominal.intensity_T,
        world=nominal.world,
    )

    typical = np.array([np.median(row[row > 0]) if row.any() else np.inf for row in before.residuals.row_information.T])

    def shifts(channels: WhitenedChannels) -> FloatArray:
        information = channels.residuals.row_information
        shift: FloatArray = channels.residuals.row_shift_T * np.sqrt(information / typical)
        shift[information == 0] = np.nan
        return shift

    before_T, after_T = shifts(before), shifts(model.base().channels)
    after_T[~model.is_counted] = np.nan
    return Residue(
        covariates.time_s,
        direction,
        before_T,
        after_T,
        shifts(twin),
        scale / np.sqrt(typical),
        nominal.recording.temperature_C,
        nominal.recording.current_A,
    )


_FOLLOWS = {
    "function_of_rate": "follows the rate of the field",
    "function_of_direction": "follows the attitude: it changes with the direction of the field",
    "function_of_tilt": "follows the tilt: it changes with the direction upwards",
}
"""Words for a residual that a function without physics explains; one of time is described by its time scale."""

_UNITS_S = (("seconds", 1.0), ("minutes", 60.0), ("hours", 3600.0))
"""Units of time, each used for two of it or more."""


def describe(found: Search, verdict: Verdict, size: Size, residue: Residue, variance: float) -> str:
    """Say what a diagnosis leaves open.

    Parameters
    ----------
    found : Search
        The search, with the evidence for functions without physics in its residual.
    verdict : str
        Of the diagnosis.
    size : Size
        Of the gap, before and after the causes.
    residue : Residue
        Of every sample.
    variance : float
        Of the channels' white noise, in that of the array's.

    Returns
    -------
    str
        Three sentences; empty where the verdict leaves nothing open.
    """
    if verdict not in ("partly_explained", "unexplained"):
        return ""
    is_unexplained = verdict == "unexplained"
    base, unknown = (found.nominal.base(), found.rivals) if is_unexplained else (found.model.base(), found.remaining)
    where = locate(base, [], unknown, variance)
    significant = [one for one in unknown if one.delta_bic >= LEAST_EVIDENCE]
    strongest = max(significant, key=lambda one: one.delta_bic).effect if significant else ""
    share = "All of the gap" if is_unexplained else f"{100 * (1 - size.closed):.2g} % of the gap's energy"
    rows_T = residue.before if is_unexplained else residue.after
    row = _largest_row(where, rows_T / residue.floor_T)
    return (
        f"{share} is open: {size.after:.2g} noise floors, {to_nanotesla(size.after_T):.3g} nT at one axis of a sensor. "
        f"It lies in {_place(where, residue)}. "
        f"It {_likeness(strongest, residue, rows_T[:, row] / residue.floor_T[row])}."
    )


def _largest_row(where: Where, rows: FloatArray) -> int:
    """Return the row of a place with the largest mean square; of all rows where there is no place."""
    energy = np.nan_to_num(np.sum(np.nan_to_num(rows) ** 2, axis=0))
    axes = ["xyz".index(axis) for axis in where.axes] or [0, 1, 2]
    inside = [
        row
        for sensor in where.sensors
        for row in ([len(energy) - 1] if sensor == "scalar" else [3 * (int(sensor) - 1) + axis for axis in axes])
    ]
    return max(inside or range(len(energy)), key=lambda row: energy[row])


def _place(where: Where, residue: Residue) -> str:
    """Return sensors, axes, span after the first sample and band in words."""
    numbers = [one for one in where.sensors if isinstance(one, int)]
    names = [f"sensor {one}" for one in numbers]
    if 3 * len(numbers) == len(residue.floor_T) - 1 > 3:
        names = ["all sensors"]
    elif len(where.axes) == 1 and numbers:
        names = [row_name(3 * (one - 1) + "xyz".index(where.axes[0]), len(residue.floor_T)) for one in numbers]
    if "scalar" in where.sensors:
        names.append("the scalar magnetometer")
    words = " and ".join(names) or "no sensor more than in the others"
    if where.time_s is not None:
        first, last = (time - residue.time_s[0] for time in where.time_s)
        words += f", from {first:.1f} to {last:.1f} s after the first sample"
    if where.frequency_hz is not None:
        words += f", at {where.frequency_hz[0]:.2g} to {where.frequency_hz[1]:.2g} Hz"
    return words


def _likeness(strongest: str, residue: Residue, values: FloatArray) -> str:
    if strongest in _FOLLOWS:
        return _FOLLOWS[strongest]
    if strongest:
        return _course(period_of(values, float(np.median(np.diff(residue.time_s)))))
    ratio = growth_with_rate(values, residue.rate)
    if ratio is None:
        return "is white: no sample tells the next, and turning does not matter"
    return f"is white, and {ratio:.2g} times as large when turning faster than half of the time"


def _course(period_s: float) -> str:
    """Return a drift with a period in words, in the largest unit of which the period has two."""
    if period_s < _UNITS_S[0][1]:
        return f"swings within a second (half of it slower than {1 / period_s:.2g} Hz)"
    name, unit_s = [each for each in _UNITS_S if period_s >= 2 * each[1] or each is _UNITS_S[0]][-1]
    return f"drifts over {name} (one swing in about {period_s / unit_s:.2g} {name})"


def period_of(values: FloatArray, step_s: float) -> float:
    """Return the period, s, above which half of the energy in excess of white noise of variance one lies.

    Parameters
    ----------
    values : (N,) array
        A residual in noise floors; NaN where it is not known.
    step_s : float
        Between samples.
    """
    power = np.abs(np.fft.rfft(np.nan_to_num(values))[1:]) ** 2 / np.isfinite(values).sum()
    slower = np.cumsum(power - 1)
    half = int(np.argmax(slower >= slower.max() / 2))
    return len(values) * step_s / (half + 1)


def growth_with_rate(values: FloatArray, rate: FloatArray) -> float | None:
    """Return the ratio of a residual's root mean square at rates above the median to that below.

    None where Spearman's rank correlation r of its size and the rate is not significant: where the evidence,
    -n log(1 - r²) - log n, is below that which any hypothesis needs.

    Parameters
    ----------
    values : (N,) array
        A residual in noise floors; NaN where it is not known.
    rate : (N,) array
        Rate at which the field turns in the array frame, rad/s; NaN where it is not known.
    """
    known = np.isfinite(values) & np.isfinite(rate)
    values, rate = values[known], rate[known]
    if not (np.ptp(rate) and np.ptp(np.abs(values))):
        return None
    correlation = float(np.corrcoef(_ranks(np.abs(values)), _ranks(rate))[0, 1])
    evidence = -len(values) * np.log1p(-(correlation**2)) - np.log(len(values))
    if correlation <= 0 or evidence < LEAST_EVIDENCE:
        return None
    is_fast = rate > np.median(rate)
    return float(np.sqrt(np.mean(values[is_fast] ** 2) / np.mean(values[~is_fast] ** 2)))


def _ranks(values: FloatArray) -> FloatArray:
    """Return the ranks of values (N,), but for a constant; equal ones share theirs."""
    _, place, count = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(count) - count / 2)[place]
