"""Effects injected into real recordings; those that follow a channel or the time have a size that can be stated."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import Generator

from tam_calibration.model.exceptions import Refused
from tam_calibration.model.units import FloatArray, to_nanotesla
from tam_validation.blind.disorder import bias_jump, noise_excess, outliers
from tam_validation.blind.disturbance import (
    ALL,
    SCALAR,
    Disturbance,
    Draw,
    by_axis,
    draw_direction,
    draw_sensor,
    of_sensors,
    proportional,
)
from tam_validation.blind.instrument_faults import (
    nonlinearity,
    quantization,
    saturation,
    stale_samples,
    time_skew,
)
from tam_validation.blind.material import hysteresis
from tam_validation.blind.recorded import Recorded, RecordedScene, model_of, own_residual, scene_of
from tam_validation.blind.scene import Scene
from tam_validation.blind.surroundings import current_interference, geomagnetic_drift, scalar_heading_error
from tam_validation.blind.visible import Scaled, scale_to

_TRIES = 20
_SEEN = 0.2
"""Least share of an injected signal that the fit must leave: below, the size depends on the fit."""


def _temperature_drift(rng: Generator, scene: Scene) -> Disturbance:
    """Let a bias follow the temperature, a little late."""
    late_s = scene.duration_s * rng.uniform(0.002, 0.01)
    warm = scene.temperature(scene.time_s - late_s)
    return _following(rng, scene, "temperature_drift", "offset", warm - warm.mean(), {"late_s": late_s})


def _current_interference(rng: Generator, scene: Scene) -> Disturbance:
    """Lay a wire that carries the current beside a lone sensor, or a cable near an array and its scalar."""
    if scene.sensor_count > 1:
        return current_interference(rng, scene)
    load = scene.current(scene.time_s)
    return _following(rng, scene, "current_interference", "field", load - load.mean(), {})


def _bias_jump(rng: Generator, scene: Scene) -> Disturbance:
    """Let the offset of a lone sensor step, or of one in an array; a magnet there reaches the scalar too."""
    if scene.sensor_count > 1:
        return bias_jump(rng, scene)
    start = rng.uniform(0.2, 0.6)
    share = np.array([start, start + rng.uniform(0.15, 0.3)] if rng.random() < 0.5 else [start])
    on = np.searchsorted(share * scene.duration_s, scene.time_s) % 2.0
    parameters = {"times_s": (share * scene.duration_s).tolist()}
    return _following(rng, scene, "bias_jump", "offset", on, parameters)


def _following(
    rng: Generator, scene: Scene, effect: str, quantity: str, course: FloatArray, parameters: dict[str, Any]
) -> Disturbance:
    """Let the readings of a sensor follow a course (N,) along one direction."""
    sensor, along = draw_sensor(rng, scene), draw_direction(rng)
    change = proportional(of_sensors(scene, {sensor: 1e-9 * np.outer(course, along)}))
    coefficients = by_axis(sensor, quantity, along)
    return Disturbance(effect, (sensor + 1,), (), change, "nT", parameters, coefficients=coefficients)


def _periodic_interference(rng: Generator, scene: Scene) -> Disturbance:
    """Let a machine hum into a sensor at one frequency."""
    sensor, along = draw_sensor(rng, scene), draw_direction(rng)
    frequency_hz = rng.uniform(0.12, 0.46) / scene.step_s
    tone = np.sin(2 * np.pi * frequency_hz * scene.time_s[:, None] + rng.uniform(0, 2 * np.pi, 3))
    change = proportional(of_sensors(scene, {sensor: 1e-9 * along * tone}))
    parameters = {"frequency_hz": frequency_hz}
    coefficients = by_axis(sensor, "tone", np.abs(along))
    return Disturbance("periodic_interference", (sensor + 1,), (), change, "nT", parameters, coefficients=coefficients)


def _of_one_axis(draw: Draw) -> Draw:
    """Return what draws a cause until it disturbs one axis or the scalar: of a sensor the fit takes up too much."""

    def drawn(rng: Generator, scene: Scene) -> Disturbance:
        while True:
            cause = draw(rng, scene)
            if cause.axes or cause.sensors == (SCALAR,):
                return cause

    return drawn


def _scalar_heading_error(rng: Generator, scene: Scene) -> Disturbance:
    """Let the scalar magnetometer err with the direction of the field."""
    if not scene.with_scalar:
        raise Refused("the recording holds no scalar, whose heading error is asked for")
    return scalar_heading_error(rng, scene)


INJECTED: dict[str, Draw] = {
    "temperature_drift": _temperature_drift,
    "current_interference": _current_interference,
    "bias_jump": _bias_jump,
    "time_skew": _of_one_axis(time_skew),
    "periodic_interference": _periodic_interference,
    "outliers": outliers,
    "noise_excess": _of_one_axis(noise_excess),
    "hysteresis": hysteresis,
    "nonlinearity": nonlinearity,
    "quantization": quantization,
    "saturation": saturation,
    "stale_samples": stale_samples,
    "geomagnetic_drift": geomagnetic_drift,
    "scalar_heading_error": _scalar_heading_error,
}
"""What can be put into a recording, by its name."""


@dataclass(frozen=True, eq=False)
class Injected:
    """A recording with an effect in it.

    Parameters
    ----------
    columns : dict
        What differs from the recording as it was, by the names of its channels: readings_T, scalar_T where it was
        recorded, and a temperature or current that is made up where the effect follows it.
    key : dict
    """

    columns: dict[str, Any]
    key: dict[str, Any]


def inject(recorded: Recorded, effect: str, times: float, seed: int) -> Injected:
    """Inject an effect into a recording, at a multiple of the recording's own residual.

    Parameters
    ----------
    recorded : Recorded
    effect : str
        One of `INJECTED`.
    times : float
    seed : int

    Raises
    ------
    Refused
        When the recording cannot be fitted, or the effect cannot be so large in it.
    """
    rng = np.random.default_rng([seed, list(INJECTED).index(effect)])
    scene = scene_of(rng, recorded)
    model = model_of(scene)
    own_nT = own_residual(model, scene, recorded)
    seen = (recorded.readings_T, scene.intensity_T if recorded.intensity_T is None else recorded.intensity_T)
    for _ in range(_TRIES):
        scaled = scale_to(model, INJECTED[effect](rng, scene), times * own_nT, seen)
        if scaled is not None and _is_seen(scene, scaled):
            break
    else:
        raise Refused(f"{effect} cannot be {times:g} times what this recording leaves by itself, {own_nT:.3g} nT")
    disturbance = scaled.disturbance
    key = {
        "effect": effect,
        "sensors": list(disturbance.sensors),
        "axes": list(disturbance.axes),
        "times": times,
        "own_residual_nT": own_nT,
        "visible_nT": scaled.visible_gap,
        "amplitude": scaled.amplitude,
        "amplitude_unit": disturbance.amplitude_unit,
        "coefficients": {name: value * scaled.amplitude for name, value in disturbance.coefficients.items()},
        "parameters": disturbance.parameters,
        "seed": seed,
    }
    columns = _made_up(rng, scene, effect) | {"readings_T": recorded.readings_T + scaled.signal[0]}
    if recorded.scalar_T is not None:
        columns["scalar_T"] = recorded.scalar_T + scaled.signal[1]
    return Injected(columns, key)


def _is_seen(scene: RecordedScene, scaled: Scaled) -> bool:
    """Say whether the fit takes up no more than is usual, and nothing but a spike is larger than the field.

    The visible gap is a mean over all sensors, the change that of the disturbed ones.
    """
    vectors, scalar = scaled.signal
    sensors = [int(sensor) - 1 for sensor in scaled.disturbance.sensors if sensor not in (ALL, SCALAR)]
    in_scalar = scaled.disturbance.sensors == (SCALAR,)
    change = scalar[:, None] if in_scalar else vectors[:, sensors or slice(None)].reshape(len(vectors), -1)
    squares = ((change - change.mean(axis=0)) ** 2).mean() * (1 if in_scalar else 3)
    spikes = scaled.disturbance.effect in ("outliers", "noise_excess")
    within = spikes or float(np.abs(change).max()) < float(scene.intensity_T.mean())
    return within and scaled.visible_gap * scene.sensor_count**0.5 > _SEEN * to_nanotesla(float(squares**0.5))


def _made_up(rng: Generator, scene: RecordedScene, effect: str) -> dict[str, FloatArray]:
    """Return the recorded temperature or current, the one that the effect follows."""
    noise = rng.normal(size=scene.sample_count)
    if effect == "temperature_drift":
        return {"temperature_C": np.round(scene.temperature(scene.time_s) + 0.02 * noise, 3)}
    if effect == "current_interference":
        return {"current_A": np.round(scene.current(scene.time_s) + 0.01 * noise, 4)}
    return {}
