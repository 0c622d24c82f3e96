"""What a simulation lacks: the effects and the noise to add to it, and text to copy into a simulator.

The SDF of Gazebo holds noise, bias and steps of the sensors; the rest is added by a plugin, or by ``tam simulate``.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np

from tam_calibration.correction.calibration import Calibration
from tam_calibration.effects.library import effect_named
from tam_calibration.gap.noise import AxisNoise
from tam_calibration.model.exceptions import sensors_in_words
from tam_calibration.model.fitted_effect import ALL, FittedEffect
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True)
class NoiseTerm:
    """Noise of one axis that a simulation shall have, and what has to be added to what it has now.

    Parameters
    ----------
    sensor : int
        Number 1…K; 0 for the scalar.
    axis : str
        "x", "y", "z"; empty for the scalar.
    white_T : float
        Standard deviation of the white noise that it shall have.
    added_white_T : float
        Standard deviation of the white noise that is missing; 0 where it has too much.
    knee_hz, exponent : float
        Of the slow noise that it shall have and has not, in addition to the white noise ``white_T``; NaN without one.
    band_hz : (float, float), optional
        Of the band of noise that it shall have and has not.
    band_T : float
        Standard deviation in the band.
    """

    sensor: int
    axis: str
    white_T: float
    added_white_T: float
    knee_hz: float = float("nan")
    exponent: float = float("nan")
    band_hz: tuple[float, float] | None = None
    band_T: float = 0.0

    @classmethod
    def of(cls, noise: AxisNoise) -> "NoiseTerm":
        """Return all the noise of an axis as noise to add."""
        return cls(**{each.name: getattr(noise, each.name.removeprefix("added_")) for each in fields(cls)})


@dataclass(frozen=True, eq=False)
class Mend:
    """What to write into the simulator.

    Parameters
    ----------
    added : tuple of FittedEffect
        Effects that the simulation lacks, in the order of their sizes; their times are since the first sample of a run.
    removed : tuple of str
        Effects that it should not have, or have with the parameters of ``added``.
    noise : tuple of NoiseTerm
        Of every axis and the scalar.
    calibration : Calibration
        Of the recording: array, errors of the sensors, noise and all its effects.
    rate_hz : float
        Of the recording's samples.
    """

    added: tuple[FittedEffect, ...]
    removed: tuple[str, ...]
    noise: tuple[NoiseTerm, ...]
    calibration: Calibration
    rate_hz: float


_PER_DECADE = 3
"""Time constants in a factor of ten: with one the density ripples by more than a fiftieth."""

_FREQUENCIES = 100
"""At which the density is fitted, equally far from each other on a logarithmic scale."""


def slow_modes(mend: Mend, term: NoiseTerm, is_one: bool = False) -> tuple[FloatArray, FloatArray]:
    """Return the first-order processes whose sum has the density of a term's slow noise, none where it has none.

    Their variances are fitted by non-negative least squares to the density, as a part of that of slow and white noise
    together, from one cycle in the span to half the rate; below it the noise is flat. An exponent is 2 at most.

    Parameters
    ----------
    mend : Mend
        Tells rate and span of the recording that showed the noise.
    term : NoiseTerm
        With knee, exponent and the white noise that they are relative to.
    is_one : bool
        Whether it shall be the single process that comes nearest; by default as many as it takes.

    Returns
    -------
    time_constant_s, variance_T2 : (J,) array
        Of each process, seconds and T².
    """
    from scipy.optimize import nnls

    if np.isnan(term.knee_hz) or term.white_T == 0:
        return np.empty(0), np.empty(0)
    rate_hz, (start_s, stop_s) = mend.rate_hz, mend.calibration.time_span_s
    shortest = 1 / (np.pi * rate_hz)
    longest = max(stop_s - start_s, 10 * shortest)
    constants = np.geomspace(shortest, longest, 1 + int(np.ceil(_PER_DECADE * np.log10(longest / shortest))))
    frequency = np.geomspace(1 / longest, rate_hz / 2, _FREQUENCIES)
    above_white = (term.knee_hz / frequency) ** term.exponent
    target = above_white / (1 + above_white)
    white = 2 * term.white_T**2 / rate_hz
    part = _density(constants, frequency, rate_hz) / (white * (1 + above_white))[:, None]
    if is_one:
        alone = target @ part / np.sum(part**2, axis=0)
        best = int(np.argmin(np.sum((part * alone - target[:, None]) ** 2, axis=0)))
        return constants[[best]], alone[[best]]
    largest = part.max(axis=0)  # the fit works with numbers about 1
    weight, _ = nnls(part / largest, target)
    return constants[weight > 0], (weight / largest)[weight > 0]


def _density(time_constant_s: FloatArray, frequency_hz: FloatArray, rate_hz: float) -> FloatArray:
    """Return the one-sided density (F, J) of sampled first-order processes (J,) of unit variance, 1/Hz."""
    decay = np.exp(-1 / (rate_hz * time_constant_s))
    turn = np.cos(2 * np.pi * frequency_hz / rate_hz)[:, None]
    return np.asarray(2 / rate_hz * (1 - decay**2) / (1 - 2 * decay * turn + decay**2))


def gazebo_sdf(mend: Mend) -> str:
    """Return a ``<sensor type="magnetometer">`` for each sensor as it shall be, in tesla.

    ``stddev`` is that of a sample's white noise. The bias is in ``mean``, for Gazebo gives ``bias_mean`` a random
    sign; ``bias_stddev`` is its standard error. Slow noise is the first-order process that comes nearest: the standard
    deviation of Gazebo's is ``dynamic_bias_stddev`` times the root of half the correlation time.

    Parameters
    ----------
    mend : Mend
        What the recording's sensors have.
    """
    blocks = []
    for sensor in range(mend.calibration.array.sensor_count):
        axes = "\n".join(_sdf_axis(mend, sensor, axis) for axis in range(3))
        blocks.append(
            f'<sensor name="tam_{sensor + 1}" type="magnetometer">\n'
            f"  <always_on>1</always_on>\n  <update_rate>{_number(mend.rate_hz)}</update_rate>\n"
            f"  <magnetometer>\n{axes}\n  </magnetometer>\n</sensor>"
        )
    comments = [f"<!-- {remark.replace('--', '- -')} -->" for remark in _remarks(mend)]
    return "\n".join([*comments, *blocks]) + "\n"


def _sdf_axis(mend: Mend, sensor: int, axis: int) -> str:
    calibration, term, step = mend.calibration, _noise(mend, sensor, axis), _step(mend, sensor, axis)
    elements = {
        "mean": calibration.errors.bias_T[sensor, axis],
        "stddev": term.white_T,
        "bias_mean": 0.0,
        "bias_stddev": np.nan_to_num(calibration.standard_errors[sensor, 6 + axis]),
    }
    for constant_s, variance_T2 in zip(*slow_modes(mend, term, is_one=True), strict=True):
        elements["dynamic_bias_stddev"] = np.sqrt(2 * variance_T2 / constant_s)
        elements["dynamic_bias_correlation_time"] = constant_s
    if step is not None:
        elements["precision"] = step
    kind = "gaussian" if step is None else "gaussian_quantized"
    inside = "".join(f"<{name}>{_number(value)}</{name}>" for name, value in elements.items())
    name = "xyz"[axis]
    return f'    <{name}><noise type="{kind}">{inside}</noise></{name}>'


def python_plugin(mend: Mend) -> str:
    """Return the lines with which a simulator's plugin adds what its readings lack.

    Parameters
    ----------
    mend : Mend
        What it lacks: the lines hand on the channels that its effects follow.
    """
    followed = {channel for fitted in mend.added for channel in effect_named(fitted.effect).channels}
    given = [name for name in ("temperature_C", "current_A", "attitude") if name in followed]
    arguments = ", ".join(["readings_T", "time_s", "scalar_T", *(f"{name}={name}" for name in given)])
    return (
        "from tam_calibration.comparison.additions import Additions\n"
        "from tam_calibration.results.comparison_json import read_mend\n"
        "\n"
        'add = Additions(read_mend("mend.yaml"), seed=1)  # once; another seed for each run\n'
        f"readings_T, scalar_T = add({arguments})  # each sample, SI\n"
    )


def _noise(mend: Mend, sensor: int, axis: int) -> NoiseTerm:
    """Return the noise of an axis, white as the array states it by default; sensor and axis count from 0."""
    place = sensor + 1, "xyz"[axis]
    stated = NoiseTerm(*place, float(mend.calibration.array.vector_noise_T[sensor]), 0.0)
    return next((term for term in mend.noise if (term.sensor, term.axis) == place), stated)


def _step(mend: Mend, sensor: int, axis: int) -> float | None:
    """Return the step of rounding at an axis, the one effect for which Gazebo has an element; None without it."""
    parts = [part for fitted in mend.added for part in fitted.contributions]
    own = [part.values for part in parts if part.sensor in (sensor, ALL) and part.axis in (axis, None)]
    return next((values["step"] for values in own if "step" in values), None)


def _remarks(mend: Mend) -> Iterator[str]:
    """Yield what the SDF leaves out."""
    yield "scale factors, non-orthogonality and misalignment are left out: the mend file has them under calibration"
    for fitted in mend.added:
        if not any("step" in part.values for part in fitted.contributions):
            yield f"{fitted.effect} goes to the mend file: let Additions or tam simulate add it"
    for name in mend.removed:
        yield f"the simulation has {name}, and the recording has it not, or otherwise: take it out"
    for term in mend.noise:
        if term.band_hz is not None:
            low, high = map(_number, term.band_hz)
            where = sensors_in_words([term.sensor or "scalar"], axes=term.axis)
            yield f"{where}: noise between {low} and {high} Hz goes to the mend file"


def _number(value: float) -> str:
    return f"{value:.6g}"
