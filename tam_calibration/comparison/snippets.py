"""Text to copy into a simulator: sensors in Gazebo's SDF, and the lines of a plugin for any simulator.

The SDF holds noise, bias and steps of the sensors; the rest is added by a plugin, or by ``tam simulate``.
"""

from collections.abc import Iterator

import numpy as np

from tam_calibration.comparison.mend import Mend, NoiseTerm
from tam_calibration.comparison.noise_stream import slow_modes
from tam_calibration.effects.library import effect_named
from tam_calibration.model.exceptions import sensors_in_words
from tam_calibration.model.fitted_effect import ALL

_STEP = "step"
"""The value of an effect for which Gazebo has an element: the step of rounding."""


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
    remarks = [*_left_out(mend), *_bands(mend)]
    return "\n".join([*map(_comment, remarks), *blocks]) + "\n"


def _sdf_axis(mend: Mend, sensor: int, axis: int) -> str:
    calibration, term, step = mend.calibration, _noise(mend, sensor, axis), _step(mend, sensor, axis)
    elements = {
        "mean": calibration.errors.bias_T[sensor, axis],
        "stddev": term.white_T,
        "bias_mean": 0.0,
        "bias_stddev": np.nan_to_num(calibration.standard_errors[sensor, 6 + axis]),
    }
    span_s = calibration.time_span_s[1] - calibration.time_span_s[0]
    modes = slow_modes(term, mend.rate_hz, span_s, most=1)
    for constant_s, variance_T2 in zip(modes.time_constant_s, modes.variance_T2, strict=True):
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
    """Return the step of rounding at an axis; None where there is none."""
    parts = [part for fitted in mend.added for part in fitted.contributions]
    own = [part.values for part in parts if part.sensor in (sensor, ALL) and part.axis in (axis, None)]
    return next((values[_STEP] for values in own if _STEP in values), None)


def _left_out(mend: Mend) -> Iterator[str]:
    """Yield what the SDF leaves out."""
    yield "scale factors, non-orthogonality and misalignment are left out: the mend file has them under calibration"
    for fitted in mend.added:
        if not any(_STEP in part.values for part in fitted.contributions):
            yield f"{fitted.effect} goes to the mend file: let Additions or tam simulate add it"
    for name in mend.removed:
        yield f"the simulation has {name}, and the recording has it not, or otherwise: take it out"


def _bands(mend: Mend) -> Iterator[str]:
    for term in mend.noise:
        if term.band_hz is not None:
            low, high = map(_number, term.band_hz)
            where = sensors_in_words([term.sensor or "scalar"], axes=term.axis)
            yield f"{where}: noise between {low} and {high} Hz goes to the mend file"


def _comment(text: str) -> str:
    return f"<!-- {text.replace('--', '- -')} -->"


def _number(value: float) -> str:
    return f"{value:.6g}"
