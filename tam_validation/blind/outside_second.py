"""A second set of causes outside the library: what batteries, coils, mounts, converters and recorders do."""

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator

from tam_calibration.model.units import FloatArray
from tam_validation.blind.disturbance import (
    ALL,
    MOVING,
    SCALAR,
    Disturbance,
    Signal,
    draw_axes,
    draw_direction,
    draw_sensor,
    named,
    of_scalar,
    of_sensors,
    proportional,
)
from tam_validation.blind.material import low_pass
from tam_validation.blind.outside import in_a_sensor, outside, read_late
from tam_validation.blind.processes import draw_wander
from tam_validation.blind.scene import Scene
from tam_validation.blind.surroundings import dipole

_FINE = 2000
"""Steps of the lamp's warmth."""


def lamp_light_shift(rng: Generator, scene: Scene) -> Disturbance:
    """Let the light of a pumped scalar's lamp shift its line: more the warmer the lamp is, which follows the air."""
    fine_s = np.linspace(-0.1 * scene.duration_s, scene.duration_s, _FINE)
    air_C = scene.temperature(fine_s)
    lamp_C = low_pass(air_C, scene.duration_s * 10 ** rng.uniform(-3, -2), fine_s)
    warm = np.interp(scene.time_s, fine_s, lamp_C - lamp_C.mean()) / np.ptp(lamp_C)
    shift = rng.choice([-1.0, 1.0]) * (warm + rng.uniform(-0.3, 0.3) * warm**2)
    return Disturbance("lamp_light_shift", (SCALAR,), (), proportional(of_scalar(scene, 1e-9 * shift)), "nT", {})


def proton_polarisation(rng: Generator, scene: Scene) -> Disturbance:
    """Polarise a proton magnetometer amid the sensors before each of its readings, which a person asks for."""
    starts_s = rng.uniform(-0.05, 1, int(rng.integers(8, 20))) * scene.duration_s
    lasting_s = scene.duration_s * rng.uniform(0.01, 0.03)
    since_s = scene.time_s[:, None] - starts_s
    on = np.asarray(((since_s >= 0) & (since_s < lasting_s)).any(axis=1))
    coil_T = dipole(draw_direction(rng), scene.positions_m)
    vectors = scene.through(on[:, None, None] * coil_T * (1e-9 / norm(coil_T, axis=1).mean()))
    change = proportional((vectors, np.zeros(scene.sample_count)))
    return Disturbance("proton_polarisation", (ALL,), (), change, "nT", {"pulses": len(starts_s)})


def dive_knife(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Let a diver's knife come near a sensor again and again, as the hand that holds the array moves."""
    swing = [draw_wander(rng, scene.duration_s, int(rng.integers(10, 20)))(scene.time_s) for _ in range(3)]
    away = np.stack(swing, axis=1) + rng.uniform(1.2, 2.0) * draw_direction(rng)
    away *= np.maximum(1, 0.7 / norm(away, axis=1, keepdims=True))
    field = dipole(draw_direction(rng), away)
    return np.asarray(field / field.std())


def supply_sag(_rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let a load draw down the supply that a sensor takes for its reference: all readings grow together."""
    load_A = scene.current(scene.time_s)
    sag = (load_A - load_A.mean()) / load_A.std()
    return np.asarray(sag[:, None] * scene.readings_T[:, sensor] / scene.intensity_T.mean())


def mount_creep(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let the glue under a sensor give way: it turns with the logarithm of the time since it was loaded."""
    yielding = np.log1p(scene.time_s / (scene.duration_s * 10 ** rng.uniform(-2, -0.3)))
    return np.cross(np.outer(yielding / yielding.std(), draw_direction(rng)), scene.core(sensor))


def interleaved_converters(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let two to four converters take turns at each axis, sample by sample, each with a gain of its own."""
    gains = rng.normal(size=(int(rng.integers(2, 5)), 3))
    gains -= gains.mean(axis=0)  # which the calibration takes off
    turn = np.round(scene.time_s / scene.step_s).astype(int) % len(gains)
    return np.asarray((gains / gains.std(axis=0))[turn] * scene.readings_T[:, sensor] / scene.intensity_T.mean())


def clock_set(rng: Generator, scene: Scene) -> Disturbance:
    """Set the wrong clock of a sensor right in the middle of a recording, or a right one wrong."""
    after = scene.time_s > rng.uniform(0.25, 0.75) * scene.duration_s
    wrong = after if rng.random() < 0.5 else ~after
    return read_late(scene, "clock_set", draw_sensor(rng, scene), rng.choice([-1.0, 1.0]) * wrong)


def crossover_distortion(rng: Generator, scene: Scene) -> Disturbance:
    """Let an output stage without bias current stay dead about zero volts, so that both halves miss a piece."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.6)

    def change(amplitude: float, seen: Signal) -> Signal:
        return of_sensors(scene, {sensor: -mask * np.clip(seen[0][:, sensor], -amplitude, amplitude)})

    return Disturbance(
        "crossover_distortion", (sensor + 1,), named(mask), change, "T of the dead zone", {}, after_noise=True
    )


def hanging_chain(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Hang a magnetised chain from the frame beside a sensor: however the array is turned, it hangs down."""
    down = -scene.to_world[:, 2]
    away = -rng.uniform(1.5, 3.0) * draw_direction(rng) - down
    distance = norm(away, axis=1, keepdims=True)
    unit = away / distance
    field = (3 * unit * (unit * down).sum(axis=1, keepdims=True) - down) / distance**3
    return np.asarray(field / field.std())


def noisy_reference(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let the reference voltage of a converter be noisy: every reading is wrong by a random part of itself."""
    return np.asarray(rng.normal(size=(scene.sample_count, 1)) * scene.readings_T[:, sensor] / scene.intensity_T.mean())


def swapped_packets(rng: Generator, scene: Scene) -> Disturbance:
    """Let packets of a sensor overtake one another on the network: two readings in a row change places."""
    sensor, chances = draw_sensor(rng, scene), rng.random(scene.sample_count - 1)

    def change(amplitude: float, seen: Signal) -> Signal:
        index = np.arange(scene.sample_count)
        for first in np.flatnonzero(chances < amplitude):
            index[[first, first + 1]] = index[[first + 1, first]]
        reading = seen[0][:, sensor]
        return of_sensors(scene, {sensor: reading[index] - reading})

    return Disturbance("swapped_packets", (sensor + 1,), (), change, "of the samples", {}, after_noise=True)


SECOND = {
    "lamp_light_shift": outside(lamp_light_shift, channel="temperature", scalar_needed=True, most_nT=100.0),
    "proton_polarisation": outside(proton_polarisation),
    "dive_knife": in_a_sensor(dive_knife),
    "supply_sag": in_a_sensor(supply_sag, channel="current"),
    "mount_creep": in_a_sensor(mount_creep),
    "interleaved_converters": in_a_sensor(interleaved_converters, 0.6),
    "clock_set": outside(clock_set, motions=MOVING),
    "crossover_distortion": outside(crossover_distortion),
    "hanging_chain": in_a_sensor(hanging_chain, channel="attitude"),
    "noisy_reference": in_a_sensor(noisy_reference, 0.3),
    "swapped_packets": outside(swapped_packets, motions=MOVING, most_nT=50_000.0, coarse=True),
}
"""The causes by their names; of those in a sensor the chance that it is one axis only."""
