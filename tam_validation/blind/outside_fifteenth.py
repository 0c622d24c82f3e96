"""A fifteenth set of causes outside the library: bottles on a carousel, drag, light loads, cards, sand and ballast."""

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator

from tam_calibration.model.units import FloatArray
from tam_validation.blind.continuous_motion import about
from tam_validation.blind.disturbance import (
    ALL,
    MOVING,
    Disturbance,
    draw_direction,
    draw_sensors,
    of_sensors,
    proportional,
)
from tam_validation.blind.outside import in_a_sensor, outside, turning_rate
from tam_validation.blind.processes import draw_wander
from tam_validation.blind.scene import Scene
from tam_validation.blind.surroundings import dipole
from tam_validation.blind.vehicle import carried, size_of


def sampling_carousel(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Turn bottles for water by a stepping motor near a sensor: the currents that hold it turn on with each bottle.

    Its two windings carry the cosine and the sine of an angle, which goes on by as many eighths of a turn each time.
    """
    bottles, eighths = int(rng.integers(6, 13)), int(rng.choice([1, 2, 3, 5, 6, 7]))
    filled_s = np.cumsum(rng.uniform(0.5, 1.5, bottles + 1))
    held = np.searchsorted(filled_s[:-1] / filled_s[-1] * scene.duration_s, scene.time_s)
    angle = np.pi / 4 * (eighths * held + rng.integers(8))
    windings = np.stack([draw_direction(rng), draw_direction(rng)])
    return np.asarray(np.stack([np.cos(angle), np.sin(angle)], axis=1) @ windings @ scene.response[sensor].T)


def dragged_arm(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Turn the array under water: the drag bends an arm backwards, so that its sensor lags by the square of the rate.

    A turn about the arm's own line does not bend it.
    """
    along = scene.positions_m[sensor] / norm(scene.positions_m[sensor])
    rate = turning_rate(scene)
    across = rate - np.outer(rate @ along, along)
    flat = np.cross(along, draw_direction(rng))  # an arm is weaker across its flat side
    weaker = np.eye(3) + rng.uniform(0, 1) * np.outer(flat, flat)
    bend = norm(across, axis=1, keepdims=True) * across @ weaker
    lag = np.cross(bend / norm(bend, axis=1).max(), scene.field_T / scene.intensity_T.mean())
    return np.asarray(lag @ scene.response[sensor].T)


def skipping_converter(rng: Generator, scene: Scene) -> Disturbance:
    """Feed some sensors by a converter that skips pulses at a light load: then its ripple is noise, else it is none."""
    fed, load_A = draw_sensors(rng, scene), scene.current(scene.time_s)
    light = load_A < np.quantile(load_A, rng.uniform(0.25, 0.6))
    ripple = 1e-9 * light * rng.normal(size=scene.sample_count)
    rows: dict[int, FloatArray] = {
        one: np.outer(ripple, rng.uniform(0.5, 1.5, 3) * rng.choice([-1, 1], 3)) for one in fed
    }
    change = proportional(of_sensors(scene, rows))
    return Disturbance("skipping_converter", tuple(one + 1 for one in fed), (), change, "nT", {})


def card_writes(rng: Generator, scene: Scene) -> Disturbance:
    """Write to a card each time that so many samples fill a block: its surge of current is in the reading of then.

    A write takes no longer than a sample, but for two or three where the card has to erase before it.
    """
    near, block = draw_sensors(rng, scene), int(rng.integers(16, 50))
    number = np.rint(scene.time_s / scene.step_s).astype(int) + int(rng.integers(block))
    writes = int(number[-1] // block) + 1
    lasts = np.where(rng.random(writes) < 0.1, rng.integers(2, 4, writes), 1)
    surge = rng.uniform(0.7, 1.3, writes)[number // block] * (number % block < lasts[number // block])
    rows: dict[int, FloatArray] = {
        one: 1e-9 * np.outer(surge, draw_direction(rng) @ scene.response[one].T) for one in near
    }
    change = proportional(of_sensors(scene, rows))
    return Disturbance("card_writes", tuple(one + 1 for one in near), (), change, "nT", {"block": block})


def clinging_sand(rng: Generator, scene: Scene) -> Disturbance:
    """Crawl over black sand: grains of magnetite cling to some housings in clumps, which the Earth's field magnetises.

    The clumps grow with the way that is covered, the less the more there clings already.
    """
    soiled, pace = draw_sensors(rng, scene), 1 + 0.6 * np.tanh(draw_wander(rng, scene.duration_s, 6)(scene.time_s))
    way = np.cumsum(pace * np.gradient(scene.time_s))
    clinging = 1 - np.exp(-rng.uniform(0.5, 3) * way / way[-1])
    field = scene.field_T / scene.intensity_T.mean()
    rows: dict[int, FloatArray] = {}
    for one in soiled:
        clumps = [(rng.uniform(0.5, 1.5), draw_direction(rng)) for _ in range(int(rng.integers(1, 4)))]
        extra = sum(size * (3 * np.outer(field @ toward, toward) - field) for size, toward in clumps)
        rows[one] = 1e-9 * clinging[:, None] * (extra @ scene.response[one].T)
    change = proportional(of_sensors(scene, rows))
    return Disturbance("clinging_sand", tuple(one + 1 for one in soiled), (), change, "nT", {})


def shifted_battery(rng: Generator, scene: Scene) -> Disturbance:
    """Trim a glider by its battery: cells in steel slide along the hull to pitch it, and turn about it to roll it.

    The pack goes with the tangent of the pitch, which balances the hull, as far as its rails let it.
    """
    hull, rails_m, steepest = np.array([1.0, 0, 0]), rng.uniform(0.03, 0.08), rng.uniform(0.5, 1.5)
    up = scene.to_world[:, 2]  # of the array's axes
    pitch = up[:, 0] / np.maximum(norm(up[:, 1:], axis=1), 1e-9)
    slide_m = rails_m * np.clip(pitch / steepest, -1, 1)
    turned = rng.uniform(0.3, 1.0) * up[:, 1]
    distance_m = float(np.abs(scene.positions_m).max()) + rng.uniform(0.4, 0.8)
    moment = about("x", turned) @ draw_direction(rng)
    pack_m = -distance_m * hull + np.outer(slide_m, hull)
    away_m = np.vstack([scene.positions_m, np.zeros(3)]) - pack_m[:, None]
    each = np.stack([dipole(one, away_m) for one in np.eye(3)])
    extra = np.einsum("nm,mnpi->npi", moment, each)
    change = carried(scene, 1e-9 * extra / size_of(extra))
    parameters = {"distance_m": distance_m, "rails_m": rails_m}
    return Disturbance("shifted_battery", (ALL,), (), change, "nT", parameters)


FIFTEENTH = {
    "sampling_carousel": in_a_sensor(sampling_carousel, 0.4, named="bias_jump"),
    "dragged_arm": in_a_sensor(dragged_arm, motions=MOVING, named="flexure"),
    "skipping_converter": outside(skipping_converter, channel="current", named="noise_excess"),
    "card_writes": outside(card_writes, named="outliers"),
    "clinging_sand": outside(clinging_sand),
    "shifted_battery": outside(shifted_battery, channel="attitude", motions=("tumbling", "figure_eight")),
}
"""The causes by their names; of those in a sensor the chance of one axis only. A glider is in nobody's hands."""
