"""Causes outside the library, the sealed half. Who writes rules of the diagnosis does not open this file.

Nor the files whose names begin like this one's, their test, or the keys of cases that hold such a cause: these are read
as counts only. A judgement on causes that somebody tuned for says nothing about those that nobody thought of.
"""

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator

from tam_calibration.model.units import FloatArray
from tam_calibration.validation.blind.disturbance import (
    ALL_AXES,
    MOVING,
    Disturbance,
    Entry,
    Signal,
    draw_axes,
    draw_direction,
    draw_sensor,
    in_one_sensor,
    numbers,
    of_sensors,
    sealed,
)
from tam_calibration.validation.blind.outside_sealed_others_whole import (
    curie_iron,
    degaussing_steps,
    dipped_couple,
    elevator_servo,
    gimbal_magnet,
    image_stabiliser,
    lagged,
    sand_pile,
    swelling_mount,
)
from tam_calibration.validation.blind.processes import draw_wander
from tam_calibration.validation.blind.scene import Scene

_FINE = 8
"""Steps of an integration in time of sampling."""


def deviation_table(rng: Generator, scene: Scene) -> Disturbance:
    """Turn the reading about a mast by a deviation card that a level ship was swung for, read off by the heading.

    Source: Handbook of Magnetic Compass Adjustment, National Geospatial-Intelligence Agency, Pub. 226, 2004.
    """
    sensor, mast = draw_sensor(rng, scene), draw_direction(rng)
    core = scene.core(sensor)
    ahead = np.cross(mast, draw_direction(rng))
    heading = np.arctan2(core @ np.cross(mast, ahead), core @ ahead)
    card = rng.normal(size=int(rng.choice([8, 12])))
    swung = np.linspace(0, 2 * np.pi, len(card), endpoint=False)
    deviation = np.interp(heading, swung, card - card.mean(), period=2 * np.pi)
    change = 1e-9 * deviation[:, None] * np.cross(mast, core)
    return in_one_sensor(scene, "deviation_table", sensor, ALL_AXES, change, {"mast": numbers(mast)})


def length_control(rng: Generator, scene: Scene) -> Disturbance:
    """Let firmware pull the raw vector, whose offset is still in it, to one length; it follows within some samples.

    Source: Markley and Crassidis, Fundamentals of Spacecraft Attitude Determination and Control, Springer 2014,
    chapter 5, on attitude from vectors of unit length.
    """
    sensor, memory = draw_sensor(rng, scene), rng.uniform(2, 10)
    raw = scene.readings_T[:, sensor] / scene.intensity_T.mean()
    length = lagged(norm(raw, axis=1), memory)
    change = 1e-9 * raw * ((length.mean() - length) / length.std())[:, None]
    return in_one_sensor(scene, "length_control", sensor, ALL_AXES, change, {"memory_samples": memory})


def counted_cycles(rng: Generator, scene: Scene) -> Disturbance:
    """Count cycles of a coil whose inductance the field changes, axis after axis: strong fields are counted longer.

    Each axis is read in the middle of its count, which begins when the one before it ends.
    Source: Leuzinger and Taylor, Magneto-Inductive Technology Overview, PNI Sensor 2010.
    """
    sensor, order = draw_sensor(rng, scene), rng.permutation(3)
    longer = rng.choice([-1.0, 1.0]) * scene.core(sensor)
    late = np.empty_like(longer)
    late[:, order] = np.cumsum(longer[:, order], axis=1) - longer[:, order] / 2

    def change(amplitude: float, _seen: object) -> Signal:
        read = [scene.readings_at(scene.time_s - amplitude * late[:, axis])[:, sensor, axis] for axis in range(3)]
        return of_sensors(scene, {sensor: np.stack(read, axis=1) - scene.readings_T[:, sensor]})

    return Disturbance("counted_cycles", (sensor + 1,), (), change, "s", {"order": order.tolist()})


def speed_filter(rng: Generator, scene: Scene) -> Disturbance:
    """Smooth each axis the less, the faster it changes, as what drives a display does.

    Source: Casiez, Roussel and Vogel, 1 € filter, Proc. CHI 2012, p. 2527.
    """
    sensor, opens = draw_sensor(rng, scene), rng.uniform(3, 10)
    reading = scene.readings_T[:, sensor]
    step_s = np.diff(scene.time_s, prepend=scene.time_s[0] - scene.step_s)[:, None]
    speed = np.abs(np.diff(reading, axis=0, prepend=reading[:1])) / step_s
    slower = 1 / (1 + opens * lagged(speed, 1.0) / speed.mean(axis=0))

    def change(amplitude: float, _seen: object) -> Signal:
        kept = amplitude * slower / (amplitude * slower + step_s)
        return of_sensors(scene, {sensor: _smoothed(reading, kept) - reading})

    return Disturbance("speed_filter", (sensor + 1,), (), change, "s", {"opens": opens})


def _smoothed(values: FloatArray, kept: FloatArray) -> FloatArray:
    """Return values (N, 3) of which each keeps a part (N, 3) of the one before."""
    now, path = values[0], []
    for value, keep in zip(values, kept, strict=True):
        now = keep * now + (1 - keep) * value
        path.append(now)
    return np.array(path)


def pulled_oscillators(rng: Generator, scene: Scene) -> Disturbance:
    """Let two excitations beat whose difference wanders through zero, where each pulls the other and they lock.

    Source: Adler, A study of locking phenomena in oscillators, Proc. IRE 34, 1946, p. 351.
    """
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.4)
    fastest, pull = rng.uniform(0.5, 1.1), rng.uniform(0.08, 0.25)
    fine_s = np.arange(0, scene.duration_s + scene.step_s, scene.step_s / _FINE)
    apart = fastest * np.tanh(draw_wander(rng, scene.duration_s, 8)(fine_s))
    phase = np.interp(scene.time_s, fine_s, _pulled(apart / _FINE, pull / _FINE, rng.uniform(0, 2 * np.pi)))
    change = 1e-9 * mask * rng.uniform(0.6, 1.4, 3) * np.sin(phase[:, None] + rng.uniform(-1, 1, 3))
    parameters = {"fastest_rad_a_sample": fastest, "pull_rad_a_sample": pull}
    return in_one_sensor(scene, "pulled_oscillators", sensor, mask, change, parameters)


def _pulled(steps: FloatArray, pull: float, phase: float) -> FloatArray:
    """Return the phases (N,) of an oscillator that goes ahead by steps (N,) and is pulled back to another."""
    path = []
    for step in steps.tolist():
        phase += step - pull * float(np.sin(phase))
        path.append(phase)
    return np.array(path)


def unfiltered_mains(rng: Generator, scene: Scene) -> Disturbance:
    """Take the filter before one sensor's converter away: the field of the mains, which the others damp, is aliased.

    It stands fixed in the room, along an ellipse, while the array turns in it.
    Source: Oppenheim and Willsky, Signals and Systems, Prentice-Hall 1997, section 7.3.
    """
    sensor, alias_hz = draw_sensor(rng, scene), rng.uniform(0.12, 0.46) / scene.step_s
    phase = 2 * np.pi * alias_hz * scene.time_s
    room = np.outer(np.cos(phase), draw_direction(rng)) + np.outer(np.sin(phase), 0.4 * draw_direction(rng))
    change = 1e-9 * np.einsum("nji,nj->ni", scene.to_world, room) @ scene.response[sensor].T
    return in_one_sensor(scene, "unfiltered_mains", sensor, ALL_AXES, change, {"alias_hz": alias_hz})


def transmit_power(rng: Generator, scene: Scene) -> Disturbance:
    """Let a radio send the louder, in steps of a decibel, the less its antenna faces the base; an input rectifies it.

    Source: 3GPP TS 25.214, section 5.1, on power control; Balanis, Antenna Theory, Wiley 2005, section 4.2.
    """
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.3)
    antenna, base, blind = draw_direction(rng), draw_direction(rng), rng.uniform(0.05, 0.15)
    base[2] *= 0.2
    along = scene.to_world @ antenna @ base / norm(base)
    fading_dB = rng.uniform(0.5, 1.5) * draw_wander(rng, scene.duration_s, 12)(scene.time_s)
    power_dB = np.round(fading_dB - 10 * np.log10(1 - along**2 + blind))
    change = 1e-9 * np.outer(10 ** (power_dB / 10), mask * rng.normal(size=3))
    return in_one_sensor(scene, "transmit_power", sensor, mask, change, {"antenna": numbers(antenna)})


def slip_ring(rng: Generator, scene: Scene) -> Disturbance:
    """Feed a sensor's reference through a slip ring, the resistance of which depends on the angle that it stands at.

    Source: Holm, Electric Contacts, Springer 1967, part III, on sliding contacts.
    """
    sensor, waves = draw_sensor(rng, scene), np.arange(1, 7)
    angle = scene.motion.angles(scene.time_s)[:, :1]
    drop = np.cos(waves * angle + rng.uniform(0, 2 * np.pi, 6)) @ rng.normal(size=6)
    change = -1e-9 * drop[:, None] * rng.uniform(0.6, 1.4, 3) * scene.core(sensor)
    return in_one_sensor(scene, "slip_ring", sensor, ALL_AXES, change, {})


SEALED: dict[str, Entry] = {
    "deviation_table": sealed(deviation_table),
    "length_control": sealed(length_control),
    "counted_cycles": sealed(counted_cycles, motions=MOVING),
    "speed_filter": sealed(speed_filter, motions=MOVING),
    "pulled_oscillators": sealed(pulled_oscillators),
    "unfiltered_mains": sealed(unfiltered_mains, named="periodic_interference"),
    "transmit_power": sealed(transmit_power),
    "slip_ring": sealed(slip_ring, motions=("turntable", "tumbling")),
    "degaussing_steps": sealed(degaussing_steps),
    "dipped_couple": sealed(dipped_couple),
    "gimbal_magnet": sealed(gimbal_magnet),
    "sand_pile": sealed(sand_pile),
    "elevator_servo": sealed(elevator_servo, motions=MOVING, scalar_needed=True),
    "image_stabiliser": sealed(image_stabiliser, motions=MOVING),
    "swelling_mount": sealed(swelling_mount),
    "curie_iron": sealed(curie_iron),
}
"""The causes by their names."""
