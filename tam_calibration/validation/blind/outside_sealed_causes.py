"""Causes outside the library, the sealed half. Who writes rules of the diagnosis does not open this file.

Nor the files whose names begin like this one's, their test, or the keys of cases that hold such a cause: these are read
as counts only. A judgement on causes that somebody tuned for says nothing about those that nobody thought of.
"""

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator

from tam_calibration.model.units import FloatArray
from tam_calibration.validation.blind.disturbance import (
    MOVING,
    SCALAR,
    SWUNG,
    Disturbance,
    Signal,
    draw_axes,
    draw_direction,
    draw_sensor,
    in_one_sensor,
    of_scalar,
    of_sensors,
    proportional,
    sealed,
)
from tam_calibration.validation.blind.outside_sealed_whole import (
    buffeted_arm,
    degaussing_coils,
    dipole,
    image_stabiliser,
    radio_bursts,
    snapping_plate,
    spinning_conductor,
    stabilised_camera,
    stressed_iron,
    swell_chain,
)
from tam_calibration.validation.blind.processes import draw_wander
from tam_calibration.validation.blind.scene import Scene

_FINE = 20
"""Steps a sample in which a phase is integrated."""


def pulled_oscillator(rng: Generator, scene: Scene) -> Disturbance:
    """Let a neighbour's excitation pull an oscillator: they beat, faster and slower, and lock for a while.

    Source: Adler, A study of locking phenomena in oscillators, Proc. IRE 34, 1946, p. 351.
    """
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.6)
    pull = 2 * np.pi * rng.uniform(0.02, 0.05)
    fine_s = np.linspace(0, scene.duration_s, _FINE * scene.sample_count)
    detuning = pull * (rng.uniform(-0.5, 0.5) + rng.uniform(1.5, 3) * draw_wander(rng, scene.duration_s, 6)(fine_s))
    phase = np.interp(scene.time_s, fine_s, _beaten(detuning, pull, fine_s[1] / scene.step_s))
    waves = np.sin(phase[:, None] + rng.uniform(0, 2 * np.pi, 3))
    change = 1e-9 * mask * rng.uniform(0.6, 1.4, 3) * waves
    return in_one_sensor(scene, "pulled_oscillator", sensor, mask, change, {"pull_radians_a_sample": pull})


def _beaten(detuning: FloatArray, pull: float, step: float) -> FloatArray:
    """Integrate Adler's equation, φ' = detuning - pull sin φ, for detunings (N,)."""
    phase, path = 0.0, []
    for apart in detuning.tolist():
        phase += step * (apart - pull * np.sin(phase))
        path.append(phase)
    return np.array(path)


def flux_jumps(rng: Generator, scene: Scene) -> Disturbance:
    """Let a superconducting loop lose its lock where the field changes fast, and lock again a quantum off.

    It is set to zero where it is more than two quanta off. It jumps often, and so is no bias that jumps once or twice.

    Source: Clarke and Braginski, The SQUID Handbook, Wiley 2004, chapter 4, on the slew rate of flux-locked loops.
    """
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.5)
    slew = np.abs(np.diff(scene.core(sensor), axis=0, prepend=scene.core(sensor)[:1])) ** 2
    chance = rng.uniform(25, 45) * slew / slew.sum(axis=0)
    kicks = rng.choice([-1.0, 1.0], slew.shape) * (rng.random(slew.shape) < chance)
    change = 1e-9 * mask * np.stack([_quanta(one) for one in kicks.T], axis=1)
    return in_one_sensor(scene, "flux_jumps", sensor, mask, change, {"jumps": int(np.count_nonzero(kicks * mask))})


def _quanta(kicks: FloatArray) -> FloatArray:
    """Return the sums (N,) of kicks (N,), which begin at nought again where they are beyond two."""
    now, path = 0.0, []
    for kick in kicks.tolist():
        now = now + kick if abs(now + kick) <= 2 else 0.0
        path.append(now)
    return np.array(path)


def delta_coding(rng: Generator, scene: Scene) -> Disturbance:
    """Send rounded differences between readings: their errors add up, until the next whole reading is sent.

    Source: Jayant and Noll, Digital Coding of Waveforms, Prentice-Hall 1984, chapter 6, on open-loop coding.
    """
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.3)
    every = int(rng.integers(20, max(22, min(70, scene.sample_count // 8))))
    frame = (np.arange(scene.sample_count) + int(rng.integers(every))) // every
    walk = np.cumsum(rng.uniform(-1, 1, (scene.sample_count, 3)), axis=0)
    first = np.searchsorted(frame, frame)
    return in_one_sensor(
        scene, "delta_coding", sensor, mask, 1e-9 * mask * (walk - walk[first]), {"every_samples": every}
    )


def coriolis_offset(rng: Generator, scene: Scene) -> Disturbance:
    """Let the mass that a Lorentz force swings feel Coriolis' force: the offset follows the rotation.

    Source: Herrera-May et al., Resonant magnetic field sensors based on MEMS technology, Sensors 9, 2009, p. 7785.
    """
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.4)
    rate = scene.motion.turning_rate(scene.time_s, scene.step_s / 50)
    change = 1e-9 * mask * (rate / rate.std() @ rng.normal(size=(3, 3)))
    return in_one_sensor(scene, "coriolis_offset", sensor, mask, change, {})


def adaptive_smoothing(rng: Generator, scene: Scene) -> Disturbance:
    """Smooth each axis by firmware with a time constant that is long at rest and short in fast motion.

    Source: Casiez, Roussel and Vogel, 1 € filter, Proc. CHI 2012, p. 2527.
    """
    sensor = draw_sensor(rng, scene)
    reading, steps_s = scene.readings_T[:, sensor], np.diff(scene.time_s)[:, None]
    speed = np.abs(np.diff(reading, axis=0)) / steps_s
    quickness = (speed / np.quantile(speed, rng.uniform(0.2, 0.4), axis=0)) ** 2

    def change(amplitude: float, _seen: object) -> Signal:
        smooth, path = reading[0], [reading[0]]
        for part, now in zip(steps_s / (steps_s + amplitude / (1 + quickness)), reading[1:], strict=True):
            smooth = smooth + part * (now - smooth)
            path.append(smooth)
        return of_sensors(scene, {sensor: np.array(path) - reading})

    return Disturbance("adaptive_smoothing", (sensor + 1,), (), change, "s", {})


def mode_hops(rng: Generator, scene: Scene) -> Disturbance:
    """Let the laser of a scalar be tuned by its temperature and hop from mode to mode, late: its light shifts the line.

    Source: Wieman and Hollberg, Using diode lasers for atomic physics, Rev. Sci. Instrum. 62, 1991, p. 1.
    """
    warm_C = scene.temperature(scene.time_s)
    apart_C = np.abs(np.diff(warm_C)).sum() / rng.uniform(9, 18)
    late = rng.uniform(0.05, 0.3)
    detuned = _detuned(warm_C / apart_C + rng.random(), late)
    parameters = {"modes_apart_C": float(apart_C), "late": late}
    return Disturbance("mode_hops", (SCALAR,), (), proportional(of_scalar(scene, 1e-9 * detuned)), "nT", parameters)


def _detuned(place: FloatArray, late: float) -> FloatArray:
    """Return how far places (N,) are from the mode, a whole number, that is left when it is further than a half off."""
    mode, path = float(np.round(place[0])), []
    for value in place.tolist():
        mode = mode if abs(value - mode) <= 0.5 + late else float(np.round(value))
        path.append(value - mode)
    return np.array(path)


def hung_scalar(rng: Generator, scene: Scene) -> Disturbance:
    """Hang a scalar on a line below what is turned: it sees a magnet there from ever another side.

    Source: Reford and Sumner, Aeromagnetics, Geophysics 29, 1964, p. 482, on the field of the aircraft at a towed bird.
    """
    # In lengths of the line.
    away = -scene.to_world[:, 2] - rng.uniform(0.2, 0.5) * draw_direction(rng)
    extra = dipole(np.tile(draw_direction(rng), (scene.sample_count, 1)), away)
    error = (extra * scene.field_T).sum(axis=1) / norm(scene.field_T, axis=1)
    return Disturbance("hung_scalar", (SCALAR,), (), proportional(of_scalar(scene, 1e-9 * error)), "nT", {})


SEALED = {
    "pulled_oscillator": sealed(pulled_oscillator),
    "flux_jumps": sealed(flux_jumps),
    "delta_coding": sealed(delta_coding),
    "coriolis_offset": sealed(coriolis_offset, motions=MOVING),
    "adaptive_smoothing": sealed(adaptive_smoothing, motions=MOVING),
    "mode_hops": sealed(mode_hops, scalar_needed=True),
    "hung_scalar": sealed(hung_scalar, scalar_needed=True),
    "stressed_iron": sealed(stressed_iron),
    "spinning_conductor": sealed(spinning_conductor),
    "image_stabiliser": sealed(image_stabiliser, motions=MOVING),
    "degaussing_coils": sealed(degaussing_coils),
    "stabilised_camera": sealed(stabilised_camera),
    "snapping_plate": sealed(snapping_plate, motions=SWUNG),
    "buffeted_arm": sealed(buffeted_arm, motions=SWUNG),
    "radio_bursts": sealed(radio_bursts),
    "swell_chain": sealed(swell_chain),
}
"""The causes by their names."""
