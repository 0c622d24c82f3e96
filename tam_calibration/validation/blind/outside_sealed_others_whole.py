"""Causes outside the library, the sealed half: what is around a sensor. The rule of `outside_sealed_causes` holds."""

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator
from scipy.signal import lfilter

from tam_calibration.model.units import FloatArray
from tam_calibration.validation.blind.continuous_motion import about
from tam_calibration.validation.blind.disturbance import (
    ALL_AXES,
    SCALAR,
    Disturbance,
    draw_direction,
    draw_sensor,
    in_one_sensor,
    numbers,
    of_scalar,
    proportional,
)
from tam_calibration.validation.blind.scene import Scene

_LEAST_DIPS, _TRIES = 6, 50
"""What is dipped in less often is a bias that jumps."""

_TERMS = 30
"""Of the series of a diffusion."""


def lagged(values: FloatArray, memory: float) -> FloatArray:
    """Return values (N, ...) that follow within so many samples."""
    keep = np.exp(-1 / memory)
    return np.asarray(lfilter([1 - keep], [1, -keep], values - values[0], axis=0) + values[0])


def degaussing_steps(rng: Generator, scene: Scene) -> Disturbance:
    """Let a ship set the currents of two degaussing coils by its heading, in steps that the coils follow.

    Source: Holmes, Reduction of a Ship's Magnetic Field Signatures, Morgan and Claypool 2008, chapter 4.
    """
    sensor, steps, memory = draw_sensor(rng, scene), int(rng.integers(1, 4)), rng.uniform(0.5, 3)
    bow = scene.to_world[:, :2, 0] / norm(scene.to_world[:, :2, 0], axis=1, keepdims=True)
    currents = lagged(np.round(steps * bow) / steps, memory)
    change = 1e-9 * currents @ np.stack([draw_direction(rng), draw_direction(rng)])
    parameters = {"steps": steps, "memory_samples": memory}
    return in_one_sensor(scene, "degaussing_steps", sensor, ALL_AXES, change, parameters)


def dipped_couple(rng: Generator, scene: Scene) -> Disturbance:
    """Dip two metals in the sea when an arm hangs low: a current that is strong at first, as their ions run short.

    Source: Bard and Faulkner, Electrochemical Methods, Wiley 2001, section 5.2, on Cottrell's law.
    """
    sensor, short = draw_sensor(rng, scene), rng.uniform(1, 6)
    for _ in range(_TRIES):
        arm = draw_direction(rng)
        height = scene.to_world[:, 2] @ arm
        wet = (height < np.quantile(height, rng.uniform(0.35, 0.6))).astype(float)
        dips = int(np.sum(wet[1:] > wet[:-1]))
        if dips >= _LEAST_DIPS:
            break
    change = 1e-9 * np.outer(wet / np.sqrt(1 + _since(wet) / short), draw_direction(rng))
    return in_one_sensor(scene, "dipped_couple", sensor, ALL_AXES, change, {"arm": numbers(arm), "dips": dips})


def _since(wet: FloatArray) -> FloatArray:
    """Return the samples (N,) since it became wet; nought where it is dry."""
    now, path = 0.0, []
    for is_wet in wet.tolist():
        path.append(now * is_wet)
        now = now + 1 if is_wet else 0.0
    return np.array(path)


def gimbal_magnet(rng: Generator, scene: Scene) -> Disturbance:
    """Carry a camera whose gimbal keeps its motors' magnets level, and follows the heading slowly.

    Source: Hilkert, Inertially stabilized platform technology, IEEE Control Syst. Mag. 28, 2008, p. 26.
    """
    sensor, away, memory = draw_sensor(rng, scene), draw_direction(rng), rng.uniform(8, 40)
    followed = lagged(scene.motion.angles(scene.time_s)[:, 0], memory)
    moment = np.einsum("nji,nj->ni", scene.to_world, about("z", followed) @ draw_direction(rng))
    change = 1e-9 * (3 * np.outer(moment @ away, away) - moment)
    return in_one_sensor(scene, "gimbal_magnet", sensor, ALL_AXES, change, {"memory_samples": memory})


def sand_pile(rng: Generator, scene: Scene) -> Disturbance:
    """Let magnetic sand lie in a housing until its slope is too steep, and then run down to a flatter one.

    Source: Jaeger, Nagel and Behringer, Granular solids, liquids, and gases, Rev. Mod. Phys. 68, 1996, p. 1259.
    """
    sensor, steepest = draw_sensor(rng, scene), rng.uniform(0.5, 0.9)
    flatter = steepest * rng.uniform(0.3, 0.7)
    lies = _run_down(-scene.to_world[:, 2], steepest, flatter)
    change = 1e-9 * lies @ rng.normal(size=(3, 3))
    parameters = {"steepest_rad": steepest, "flatter_rad": flatter}
    return in_one_sensor(scene, "sand_pile", sensor, ALL_AXES, change, parameters)


def _run_down(down: FloatArray, steepest: float, flatter: float) -> FloatArray:
    """Return where sand lies (N, 3): when it is more than the steepest off the way down, it runs to the flatter one."""
    lies, path = down[0], []
    for low in down:
        if lies @ low < np.cos(steepest):
            side = lies - (lies @ low) * low
            lies = np.cos(flatter) * low + np.sin(flatter) * side / max(norm(side), 1e-12)
        path.append(lies)
    return np.array(path)


def elevator_servo(rng: Generator, scene: Scene) -> Disturbance:
    """Let an elevator work against pitch and pitch rate, to its stops; the magnets of its servo turn with it.

    Source: Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, Wiley 2011, section 12.2.
    """
    rate = scene.motion.turning_rate(scene.time_s, scene.step_s / 50)[:, 1]
    steep = scene.to_world[:, 2, 0]
    asked = rng.uniform(0.6, 1.2) * steep / steep.std() + rng.uniform(0.4, 1.2) * rate / rate.std()
    angle = rng.uniform(0.4, 0.9) * np.clip(asked, -1, 1)
    turned = np.outer(np.sin(angle), draw_direction(rng)) + np.outer(np.cos(angle) - 1, draw_direction(rng))
    error = 1e-9 * (turned * scene.field_T).sum(axis=1) / scene.intensity_T
    return Disturbance("elevator_servo", (SCALAR,), (), proportional(of_scalar(scene, error)), "nT", {})


def image_stabiliser(rng: Generator, scene: Scene) -> Disturbance:
    """Let a camera's lens, on magnets, move against the turning until its springs centre it, or to its stops.

    Source: La Rosa et al., Optical Image Stabilization, STMicroelectronics 2015.
    """
    sensor, memory = draw_sensor(rng, scene), rng.uniform(4, 20)
    rate = scene.motion.turning_rate(scene.time_s, scene.step_s / 50)
    plane = np.stack([draw_direction(rng), draw_direction(rng)], axis=1)
    moved = lagged(rate @ plane, memory)
    stops = np.quantile(np.abs(moved), rng.uniform(0.4, 0.8))
    change = 1e-9 * np.clip(moved / stops, -1, 1) @ rng.normal(size=(2, 3))
    return in_one_sensor(scene, "image_stabiliser", sensor, ALL_AXES, change, {"memory_samples": memory})


def swelling_mount(rng: Generator, scene: Scene) -> Disturbance:
    """Put a mount of nylon in water: it swells as that diffuses in, and warps; out of the water it dries.

    Source: Crank, The Mathematics of Diffusion, Oxford 1975, section 4.3, on a plane sheet.
    """
    sensor, axis = draw_sensor(rng, scene), draw_direction(rng)
    times_s = scene.duration_s * np.array([rng.uniform(-0.05, 0.2), rng.uniform(0.45, 0.75)])
    whole_s = scene.duration_s * rng.uniform(0.4, 2)
    soaked, dried = (_diffused((scene.time_s - time_s) / whole_s) for time_s in times_s)
    change = 1e-9 * np.cross(axis, scene.core(sensor)) * (soaked - dried)[:, None]
    parameters = {"times_s": numbers(times_s), "whole_s": whole_s}
    return in_one_sensor(scene, "swelling_mount", sensor, ALL_AXES, change, parameters)


def _diffused(since: FloatArray) -> FloatArray:
    """Return the part (N,) of all that diffuses into a sheet which is in it, at times in thickness² over diffusivity.

    Nothing is before a time of zero.
    """
    odd = (2 * np.arange(_TERMS) + 1) ** 2 * np.pi**2
    left = np.exp(-np.maximum(since, 0)[:, None] * odd) @ (8 / odd)
    return np.where(since > 0, 1 - left, 0.0)


def curie_iron(rng: Generator, scene: Scene) -> Disturbance:
    """Fix a sensor beside a part of an alloy whose Curie point is that of a warm day: its induced field fades there.

    Source: Cullity and Graham, Introduction to Magnetic Materials, Wiley 2009, section 4.2, on the molecular field.
    """
    sensor, easy = draw_sensor(rng, scene), draw_direction(rng)
    warm_C = lagged(scene.temperature(scene.time_s), scene.sample_count * rng.uniform(0.005, 0.03))
    point_C = np.quantile(warm_C, rng.uniform(0.4, 0.8))
    strength = np.sqrt(np.maximum(point_C - warm_C, 0) / np.ptp(warm_C))
    change = 1e-9 * np.outer(strength * (scene.core(sensor) @ easy), draw_direction(rng))
    return in_one_sensor(scene, "curie_iron", sensor, ALL_AXES, change, {"point_C": float(point_C)})
