"""Causes outside the library, the sealed half: on the platform. As ``outside_sealed.py``: do not open."""

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator
from scipy.signal import lfilter

from tam_calibration.model.units import FloatArray, from_degrees
from tam_calibration.validation.blind.continuous_motion import about
from tam_calibration.validation.blind.disturbance import (
    ALL_AXES,
    Disturbance,
    draw_axes,
    draw_direction,
    draw_sensor,
    in_one_sensor,
    numbers,
)
from tam_calibration.validation.blind.processes import draw_wander
from tam_calibration.validation.blind.scene import Scene

_LEAST_SNAPS, _TRIES = 5, 50
"""What snaps less often is a mount that slips."""


def dipole(moments: FloatArray, away: FloatArray) -> FloatArray:
    """Return the fields (N, 3) of moments (N, 3) at distances (N, 3) from them."""
    distance = norm(away, axis=1, keepdims=True)
    unit = away / distance
    return np.asarray((3 * unit * (unit * moments).sum(axis=1, keepdims=True) - moments) / distance**3)


def stressed_iron(rng: Generator, scene: Scene) -> Disturbance:
    """Let the weight strain a bracket of soft iron: the field magnetises it the more or the less by the stress.

    Source: Jiles, Theory of the magnetomechanical effect, J. Phys. D 28, 1995, p. 1537.
    """
    sensor, loaded, along = draw_sensor(rng, scene), draw_direction(rng), draw_direction(rng)
    stress = scene.to_world[:, 2] @ loaded
    susceptibility = stress + rng.uniform(-0.5, 0.5) * stress**2
    induced = susceptibility * (scene.field_T @ along) / scene.intensity_T.mean()
    away = np.tile(draw_direction(rng), (scene.sample_count, 1))
    change = 1e-9 * dipole(np.outer(induced, along), away)
    return in_one_sensor(scene, "stressed_iron", sensor, ALL_AXES, change, {"along": numbers(along)})


def spinning_conductor(rng: Generator, scene: Scene) -> Disturbance:
    """Spin a bell of aluminium in the field, faster and slower: its eddy currents lag behind and screen the field.

    Source: Perry and Jones, Eddy current induction in a solid conducting cylinder with a transverse magnetic field,
    IEEE Trans. Magn. 14, 1978, p. 227.
    """
    sensor, axle = draw_sensor(rng, scene), draw_direction(rng)
    speed = rng.uniform(0.5, 2) * np.exp(0.8 * draw_wander(rng, scene.duration_s, 10)(scene.time_s))[:, None]
    moments = _induced(speed, axle, scene.field_T / scene.intensity_T.mean())
    change = 1e-9 * dipole(moments, np.tile(draw_direction(rng), (scene.sample_count, 1)))
    return in_one_sensor(scene, "spinning_conductor", sensor, ALL_AXES, change, {"axle": numbers(axle)})


def _induced(speed: FloatArray, axle: FloatArray, field: FloatArray) -> FloatArray:
    """Return the moments (N, 3) that a field (N, 3) induces at a speed (N, 1) over that of the currents' decay."""
    across = field - np.outer(field @ axle, axle)
    return np.asarray((speed * np.cross(axle, across) - speed**2 * across) / (1 + speed**2))


def image_stabiliser(rng: Generator, scene: Scene) -> Disturbance:
    """Let a camera's lens and its magnets move against each turn, to their stops, and go back to the middle slowly.

    Source: La Rosa et al., Optical image stabilization (OIS), white paper, STMicroelectronics 2015.
    """
    sensor = draw_sensor(rng, scene)
    memory, stops = rng.uniform(5, 25), rng.uniform(0.8, 2)
    rate = scene.motion.turning_rate(scene.time_s, scene.step_s / 50)
    turns = rate @ np.stack([draw_direction(rng), draw_direction(rng)]).T
    turns /= turns.std(axis=0) * np.sqrt(memory)
    moved = np.stack([_between_stops(one, np.exp(-1 / memory), stops) for one in turns.T], axis=1)
    change = 1e-9 * moved @ np.stack([draw_direction(rng), draw_direction(rng)])
    return in_one_sensor(scene, "image_stabiliser", sensor, ALL_AXES, change, {"memory_samples": memory})


def _between_stops(steps: FloatArray, keep: float, stop: float) -> FloatArray:
    """Return the places (N,) that steps (N,) lead to between two stops, a part of each place kept."""
    place, path = 0.0, []
    for step in steps.tolist():
        place = min(max(keep * place + step, -stop), stop)
        path.append(place)
    return np.array(path)


def degaussing_coils(rng: Generator, scene: Scene) -> Disturbance:
    """Let a ship's coils work against what the Earth magnetises, by a table of the heading in whole steps.

    Source: Holmes, Reduction of a Ship's Magnetic Field Signatures, Morgan & Claypool 2008, chapter 4.
    """
    sensor = draw_sensor(rng, scene)
    step, memory = from_degrees(rng.uniform(15, 40)), rng.uniform(1, 5)
    heading = step * np.round(scene.motion.angles(scene.time_s)[:, 0] / step)
    wanted = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    keep = np.exp(-1 / memory)
    currents = lfilter([1 - keep], [1, -keep], wanted - wanted[0], axis=0) + wanted[0]
    change = 1e-9 * currents @ np.stack([draw_direction(rng), draw_direction(rng)])
    return in_one_sensor(scene, "degaussing_coils", sensor, ALL_AXES, change, {"step_rad": float(step)})


def stabilised_camera(rng: Generator, scene: Scene) -> Disturbance:
    """Keep a magnetised camera level in a gimbal that follows the heading slowly, while the sensor beside it tilts.

    Source: Hilkert, Inertially stabilized platform technology, IEEE Control Syst. Mag. 28, 2008, p. 26.
    """
    sensor, memory = draw_sensor(rng, scene), rng.uniform(5, 40)
    heading, keep = scene.motion.angles(scene.time_s)[:, 0], np.exp(-1 / memory)
    followed = lfilter([1 - keep], [1, -keep], heading - heading[0]) + heading[0]
    moment = draw_direction(rng) * np.array([1, 1, 0.3])
    moments = np.einsum("nji,nj->ni", scene.to_world, about("z", followed) @ moment)
    change = 1e-9 * dipole(moments, np.tile(draw_direction(rng), (scene.sample_count, 1)))
    return in_one_sensor(scene, "stabilised_camera", sensor, ALL_AXES, change, {"memory_samples": memory})


def snapping_plate(rng: Generator, scene: Scene) -> Disturbance:
    """Mount a sensor on a curved sheet, which bends under the weight and snaps through, late on the way back.

    Source: Timoshenko and Gere, Theory of Elastic Stability, McGraw-Hill 1961, chapter 7.
    """
    sensor, axis = draw_sensor(rng, scene), draw_direction(rng)
    for _ in range(_TRIES):
        weight = scene.to_world[:, 2] @ draw_direction(rng)
        weight -= np.median(weight)
        bent = _snapped(rng.uniform(1.6, 2.6) * weight / np.quantile(np.abs(weight), 0.9))
        snaps = int(np.count_nonzero(np.diff(np.sign(bent))))
        if snaps >= _LEAST_SNAPS:
            break
    change = 1e-9 * np.cross(axis, scene.core(sensor)) * bent[:, None]
    return in_one_sensor(scene, "snapping_plate", sensor, ALL_AXES, change, {"axis": numbers(axis), "snaps": snaps})


def _snapped(load: FloatArray) -> FloatArray:
    """Return where (N,) a sheet rests, 4 x³ - 3 x = load, under loads (N,) in units of that at the fold."""
    side, sides = 1.0, []
    for force in load.tolist():
        side = side if side * force >= -1 else -side
        sides.append(side)
    along = np.array(sides) * load
    inside, beyond = np.arccos(np.minimum(along, 1)), np.arccosh(np.maximum(along, 1))
    return np.array(sides) * np.where(along > 1, np.cosh(beyond / 3), np.cos(inside / 3))


def buffeted_arm(rng: Generator, scene: Scene) -> Disturbance:
    """Let the stream shake a turning arm, nearly by the cube of its speed: the sensor trembles across the field.

    Source: Simiu and Scanlan, Wind Effects on Structures, Wiley 1996, chapter 6, on buffeting.
    """
    sensor = draw_sensor(rng, scene)
    rate = scene.motion.turning_rate(scene.time_s, scene.step_s / 50)
    speed = norm(np.cross(rate, draw_direction(rng)), axis=1)
    loud = (speed / np.quantile(speed, 0.9)) ** rng.uniform(2.5, 3)
    angles = rng.normal(size=(scene.sample_count, 3)) * loud[:, None]
    change = 1e-9 * np.cross(angles, scene.core(sensor))
    return in_one_sensor(scene, "buffeted_arm", sensor, ALL_AXES, change, {})


def radio_bursts(rng: Generator, scene: Scene) -> Disturbance:
    """Let an amplifier rectify a radio's bursts, which come at any time, by what its antenna has in the way to it.

    Source: Texas Instruments, EMI rejection ratio of operational amplifiers, application report SBOA128, 2011.
    """
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.5)
    stays = np.tile([rng.uniform(6, 20), rng.uniform(2, 6)], scene.sample_count)
    edges_s = scene.step_s * np.cumsum(rng.exponential(stays))
    sent = np.searchsorted(edges_s, scene.time_s) % 2
    station = np.einsum("nij,i->nj", scene.to_world, draw_direction(rng))
    strength = (1 - (station @ draw_direction(rng)) ** 2) ** rng.uniform(1, 2)
    change = 1e-9 * np.outer(sent * strength, mask * rng.choice([-1.0, 1.0], 3) * rng.uniform(0.5, 1.5, 3))
    return in_one_sensor(scene, "radio_bursts", sensor, mask, change, {"share": float(sent.mean())})


def swell_chain(rng: Generator, scene: Scene) -> Disturbance:
    """Let swell in groups, and a wind sea on it, heave a moored hull: a chain of steel comes nearer and turns away.

    Source: Holthuijsen, Waves in Oceanic and Coastal Waters, Cambridge 2007, section 6.3, on the spectrum of JONSWAP.
    """
    sensor, period = draw_sensor(rng, scene), rng.uniform(9, 18)
    systems = [(1 / period, 1.0), (rng.uniform(1.6, 2.2) / period, rng.uniform(0.2, 0.5))]
    samples = scene.time_s / scene.step_s
    heave = sum(size * _sea(rng, samples, peak) for peak, size in systems)
    # In distances of the chain at rest, which heave of three standard deviations does not use up.
    away = draw_direction(rng) + 0.15 * np.outer(heave, draw_direction(rng))
    field = dipole(np.tile(draw_direction(rng), (scene.sample_count, 1)), away)
    change = 1e-9 * (field - field.mean(axis=0)) / field.std()
    return in_one_sensor(scene, "swell_chain", sensor, ALL_AXES, change, {"period_samples": period})


def _sea(rng: Generator, time: FloatArray, peak: float) -> FloatArray:
    """Return the heave (N,) of unit size of random waves with JONSWAP's spectrum about a peak frequency."""
    frequency = peak * np.sort(rng.uniform(0.5, 2.5, 400))
    ratio, width = frequency / peak, np.where(frequency <= peak, 0.07, 0.09)
    enhanced = 3.3 ** np.exp(-(((ratio - 1) / width) ** 2) / 2)
    spectrum = ratio**-5.0 * np.exp(-1.25 * ratio**-4.0) * enhanced
    phase = rng.uniform(0, 2 * np.pi, len(frequency))
    heave = np.cos(2 * np.pi * np.outer(time, frequency) + phase) @ np.sqrt(spectrum)
    return np.asarray(heave * np.sqrt(2 / spectrum.sum()))
