"""Causes outside the library, the open half: in one sensor or the scalar. Rules of a diagnosis may be tuned on these.

Some have had a name in the library since, or are an effect of it by another law: that name is as right as none.
"""

import numpy as np
from numpy.random import Generator

from tam_calibration.model.units import FloatArray
from tam_calibration.validation.blind.continuous_motion import about
from tam_calibration.validation.blind.disturbance import (
    MOVING,
    SWUNG,
    Disturbance,
    draw_axes,
    draw_direction,
    draw_sensor,
    in_one_sensor,
    numbers,
    outside,
)
from tam_calibration.validation.blind.outside_courses import (
    ageing_bias,
    burst_noise,
    centrifugal_bias,
    coil_self_heating,
    creeping_bias,
    cycling_bias,
    gyroscopic_shift,
    orientation_noise,
    passing_iron,
    relaxing_tail,
    spinning_part,
    sunlit_side,
    supply_sag,
    swinging_magnet,
)
from tam_calibration.validation.blind.outside_instrument import (
    adaptive_zero,
    automatic_gain,
    barkhausen_noise,
    cell_handover,
    coarse_compensation,
    degauss_residue,
    drifting_clock,
    fading_film,
    gyro_fusion,
    hanging_mass,
    idle_tone,
    lost_lock,
    polled_sensor,
    reference_noise,
    report_on_change,
    shared_reference,
    slew_limit,
    weak_bit,
)
from tam_calibration.validation.blind.outside_platform import (
    cable_windup,
    compass_needle,
    fluttering_tow,
    heading_gear,
    irregular_strokes,
    lost_motion,
    moved_soft_iron,
    rubber_mount,
    sliding_tray,
    sonar_recharge,
    steering_current,
    thermal_play,
    viscous_remanence,
    whipping_boom,
)
from tam_calibration.validation.blind.processes import draw_wander
from tam_calibration.validation.blind.scene import Scene

_LEAST_FALLS, _TRIES = 4, 50
"""Least number of falls (with fewer it is a bias jump), and attempts to draw so many."""


def random_walk_bias(rng: Generator, scene: Scene) -> Disturbance:
    """Let a bias walk at random, restlessly."""
    sensor = draw_sensor(rng, scene)
    steps = rng.normal(size=(scene.sample_count, 3)) * np.gradient(scene.time_s)[:, None] ** 0.5
    walk = np.cumsum(steps, axis=0)
    return in_one_sensor(scene, "random_walk_bias", sensor, np.ones(3), 1e-9 * walk / walk.std(), {})


def pressure_chirp(rng: Generator, scene: Scene) -> Disturbance:
    """Let an axis follow a depth nobody recorded: down and up, ever faster."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.6)
    share = scene.time_s / scene.duration_s
    cycles = rng.uniform(3, 7)
    depth = np.sin(2 * np.pi * (0.3 * share + (cycles - 0.3) * share**2 / 2) + rng.uniform(0, 2 * np.pi))
    change = 1e-9 * np.outer(depth + 0.3 * depth**2, mask * rng.uniform(0.5, 1.5, 3))
    return in_one_sensor(scene, "pressure_chirp", sensor, mask, change, {"cycles": cycles})


def gain_wander(rng: Generator, scene: Scene) -> Disturbance:
    """Gains that depend on the time of day."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.5)
    wander = np.stack([draw_wander(rng, scene.duration_s, 7)(scene.time_s) for _ in range(3)], axis=1)
    return in_one_sensor(scene, "gain_wander", sensor, mask, 1e-9 * mask * wander * scene.core(sensor), {})


def mount_slip(rng: Generator, scene: Scene) -> Disturbance:
    """Turn a sensor in its mount by a little, and later by a little more."""
    sensor = draw_sensor(rng, scene)
    times_s = np.sort(rng.uniform(0.2, 0.8, 2)) * scene.duration_s
    angles = rng.normal(size=(3, 3))
    angles[0] = 0
    turned = angles[np.searchsorted(times_s, scene.time_s)]
    change = 1e-9 * np.cross(turned, scene.core(sensor))
    return in_one_sensor(scene, "mount_slip", sensor, np.ones(3), change, {"times_s": numbers(times_s)})


def cross_field(rng: Generator, scene: Scene) -> Disturbance:
    """Let an axis answer to the product of the fields along the two others."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.5)
    core = scene.core(sensor)
    product = core[:, [1, 2, 0]] * core[:, [2, 0, 1]] * (1 + 0.5 * core)
    change = 1e-9 * mask * rng.uniform(0.6, 1.4, 3) * product
    return in_one_sensor(scene, "cross_field", sensor, mask, change, {})


def multiplexer_bleed(rng: Generator, scene: Scene) -> Disturbance:
    """Another sensor's reading bleeds in, late, whenever the multiplexer is busy."""
    sensor = draw_sensor(rng, scene)
    other = int(rng.choice([k for k in range(scene.sensor_count) if k != sensor] or [sensor]))
    late_s = scene.step_s * rng.uniform(1, 4)
    busy = draw_wander(rng, scene.duration_s, 24)(scene.time_s) > 0
    bled = scene.readings_at(scene.time_s - late_s)[:, other] / scene.intensity_T.mean()
    mixed = bled @ about("xyz"[rng.integers(3)], rng.uniform(0, 2 * np.pi, 1))[0].T
    change = 1e-9 * busy[:, None] * mixed
    parameters = {"from": other + 1, "late_s": late_s}
    return in_one_sensor(scene, "multiplexer_bleed", sensor, np.ones(3), change, parameters)


def two_state_gain(rng: Generator, scene: Scene) -> Disturbance:
    """Flip an amplifier between two gains, many times."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.5)
    flips_s = np.sort(rng.uniform(0, scene.duration_s, int(rng.integers(9, 25))))
    high = np.searchsorted(flips_s, scene.time_s)[:, None] % 2
    change = 1e-9 * mask * rng.uniform(0.6, 1.4, 3) * high * scene.core(sensor)
    return in_one_sensor(scene, "two_state_gain", sensor, mask, change, {"flips": len(flips_s)})


def stiction(rng: Generator, scene: Scene) -> Disturbance:
    """Let a loose part in a sensor fall from side to side as it is turned, late and never twice alike."""
    sensor = draw_sensor(rng, scene)
    for _ in range(_TRIES):
        axis = draw_direction(rng)
        sides = _fallen(rng, scene.to_world[:, 2] @ axis)
        falls = int(np.sum(np.diff(np.sign(sides)) != 0))
        if falls >= _LEAST_FALLS:
            break
    change = 1e-9 * np.outer(sides, draw_direction(rng))
    return in_one_sensor(scene, "stiction", sensor, np.ones(3), change, {"axis": numbers(axis), "falls": falls})


def _fallen(rng: Generator, tilt: FloatArray) -> FloatArray:
    """Return on which side a loose part lies, and how far from the middle."""
    side, sides = 1.0, []
    for value in tilt.tolist():
        if value * side < -rng.uniform(0.05, 0.9):
            side = -side
        sides.append(side * rng.uniform(0.7, 1.0))
    return np.array(sides)


OUTSIDE = {
    "random_walk_bias": outside(random_walk_bias),
    "pressure_chirp": outside(pressure_chirp),
    "gain_wander": outside(gain_wander),
    "mount_slip": outside(mount_slip, named="scale_step"),
    "cross_field": outside(cross_field),
    "multiplexer_bleed": outside(multiplexer_bleed, named="crosstalk"),
    "two_state_gain": outside(two_state_gain, named="gain_switching"),
    "stiction": outside(stiction),
    "ageing_bias": outside(ageing_bias),
    "creeping_bias": outside(creeping_bias),
    "cycling_bias": outside(cycling_bias),
    "supply_sag": outside(supply_sag),
    "relaxing_tail": outside(relaxing_tail),
    "spinning_part": outside(spinning_part),
    "burst_noise": outside(burst_noise),
    "passing_iron": outside(passing_iron),
    "swinging_magnet": outside(swinging_magnet),
    "orientation_noise": outside(orientation_noise),
    "centrifugal_bias": outside(centrifugal_bias, motions=MOVING),
    "gyroscopic_shift": outside(gyroscopic_shift, motions=MOVING, scalar_needed=True),
    "coil_self_heating": outside(coil_self_heating, motions=MOVING),
    "sunlit_side": outside(sunlit_side),
    "fading_film": outside(fading_film),
    "degauss_residue": outside(degauss_residue),
    "barkhausen_noise": outside(barkhausen_noise),
    "automatic_gain": outside(automatic_gain),
    "adaptive_zero": outside(adaptive_zero),
    "coarse_compensation": outside(coarse_compensation),
    "hanging_mass": outside(hanging_mass),
    "lost_lock": outside(lost_lock, motions=MOVING, scalar_needed=True),
    "lost_motion": outside(lost_motion, motions=SWUNG),
    "fluttering_tow": outside(fluttering_tow),
    "whipping_boom": outside(whipping_boom, motions=MOVING),
    "compass_needle": outside(compass_needle),
    "moved_soft_iron": outside(moved_soft_iron),
    "heading_gear": outside(heading_gear, motions=SWUNG),
    "irregular_strokes": outside(irregular_strokes),
    "drifting_clock": outside(drifting_clock, motions=MOVING),
    "weak_bit": outside(weak_bit, named="nonlinearity"),
    "shared_reference": outside(shared_reference),
    "reference_noise": outside(reference_noise),
    "idle_tone": outside(idle_tone),
    "slew_limit": outside(slew_limit, motions=MOVING),
    "report_on_change": outside(report_on_change, named="stale_samples", motions=MOVING),
    "polled_sensor": outside(polled_sensor, motions=MOVING),
    "gyro_fusion": outside(gyro_fusion, motions=MOVING),
    "cell_handover": outside(cell_handover, scalar_needed=True),
    "cable_windup": outside(cable_windup),
    "rubber_mount": outside(rubber_mount, named="flexure"),
    "sliding_tray": outside(sliding_tray),
    "steering_current": outside(steering_current, motions=MOVING),
    "viscous_remanence": outside(viscous_remanence),
    "sonar_recharge": outside(sonar_recharge),
    "thermal_play": outside(thermal_play, named="temperature_drift"),
}
"""The causes by their names."""
