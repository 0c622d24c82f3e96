"""Recordings of a world that others made, as the other side of a simulation from MuJoCo."""

import importlib.util
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np

from pairs.making import PLAIN, Columns, Pair
from pairs.plan import PairPlan
from pairs.run import CHANNELS, draw_simulation
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray, from_nanotesla
from tam_validation.blind import case
from tam_validation.blind.continuous_motion import ContinuousMotion
from tam_validation.blind.processes import draw_load, draw_weather
from tam_validation.blind.scene import Scene

MOVING = ("tumble", "auv")
"""Its motions in which an array turns all the time."""


@cache
def load_world(path: Path) -> ModuleType:
    """Return the world of a Python file.

    Raises
    ------
    InputError
        When there is none.
    """
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise InputError(f"{path} is not the Python file of a world")
    world = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(world)
    return world


def make_world_pair(plan: PairPlan, path: Path, seed: int, number: int) -> Pair:
    """Make a pair whose recording is of the world, the same for the same seed and number."""
    rng, world = np.random.default_rng([seed, number]), load_world(path)
    effect = plan.missing[0]
    motion = str(rng.choice([one for one in MOVING if one in world.EFFECTS[effect]]))
    drawn = int(rng.integers(2**30))
    amplitude = float(world.calibrate_amp(drawn, motion, effect, plan.gaps[0]))
    made = world.simulate(drawn, motion, effect, amplitude)
    simulation = draw_simulation(rng, _scene(rng, made))
    cause = {
        "effect": effect,
        "sensors": made["where"]["sensors"],
        "axes": made["where"]["axes"],
        "visible_gap": plan.gaps[0],
        "amplitude": amplitude,
        "samples_changed": len(made["t"]),
    }
    key = {
        "kind": plan.kind,
        "detail": "",
        "gap": plan.gaps[0],
        "missing": [cause],
        "surplus": [],
        "samples": len(made["t"]),
        "rate_hz": made["fs"],
        "motion": motion,
        "stated_noise_nT": made["sv"],
    }
    array = {"baseline_m": made["base"], "vector_noise_nT": made["sv"], "scalar_noise_nT": made["ss"]}
    return Pair(
        case.columns_of(rng, simulation.scene, PLAIN, simulation.seen),
        _columns(made),
        array,
        key,
    )


def _scene(rng: np.random.Generator, made: dict[str, FloatArray]) -> Scene:
    """Return what a simulation of the same array has to know of a recording."""
    end_s = float(made["t"][-1])
    return Scene(
        time_s=made["t"],
        duration_s=end_s,
        step_s=1 / float(made["fs"]),
        motion=ContinuousMotion(str(made["traj"]), lambda at_s: np.zeros((len(at_s), 3))),
        world_field=lambda at_s: np.zeros((len(at_s), 3)),
        positions_m=Array.cross(float(made["base"])).positions_m,
        response=np.tile(np.eye(3), (4, 1, 1)),
        bias_T=np.zeros((4, 3)),
        vector_noise_T=float(from_nanotesla(made["sv"])),
        scalar_noise_T=float(from_nanotesla(made["ss"])),
        with_scalar=True,
        channels=CHANNELS,
        temperature=draw_weather(rng, end_s),
        current=draw_load(rng, end_s),
    )


def _columns(made: dict[str, FloatArray]) -> Columns:
    names = [f"b{sensor}{axis}_nT" for sensor in range(1, 5) for axis in "xyz"]
    columns = {"time_s": made["t"], **dict(zip(names, made["y"].reshape(len(made["t"]), -1).T, strict=True))}
    columns |= {"scalar_nT": made["scalar"], "temperature_C": made["temp"], "current_A": made["current"]}
    return columns | dict(zip(("qx", "qy", "qz", "qw"), made["att"].T, strict=True))
