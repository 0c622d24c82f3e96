"""One pair: both runs, what is wrong with each, what is given out, and the key."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.random import Generator

from pairs.mistakes import mistaken_columns, mistaken_run, mistaken_vehicle
from pairs.noise import coloured, levels_nT, louder
from pairs.plan import PairPlan
from pairs.run import Run, draw_field, draw_recording, draw_simulation, draw_vehicle, run_of
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.units import FloatArray, to_nanotesla
from tam_validation.blind import case
from tam_validation.blind.case_plan import CasePlan
from tam_validation.blind.catalogue import CAUSES
from tam_validation.blind.disturbance import MOVING
from tam_validation.blind.visible import NominalModel, Scaled, scale_to

TIMES = 2.5
"""Amplitude of an effect in the recording over that in the simulation, where its parameters are other ones."""

_TRIES = 300
"""Draws of a pair in which the causes can be seen."""

PLAIN = CasePlan("single", ("noise_excess",), ())
"""A plan that withholds no channel."""

Columns = dict[str, FloatArray]


@dataclass(frozen=True, eq=False)
class Pair:
    """A pair as it goes to files.

    Parameters
    ----------
    simulation, recording : dict
        Columns of the tables.
    array : dict
        Content of the array file of both.
    key : dict
    mended : dict, optional
        Columns of the simulation with the recording's effect at the same parameters, where these can be the same.
    """

    simulation: Columns
    recording: Columns
    array: dict[str, Any]
    key: dict[str, Any]
    mended: Columns | None = None


@dataclass(frozen=True, eq=False)
class _Sides:
    """The two runs, the causes in each, and in the recording the generators' seeds of those."""

    simulation: Run
    recording: Run
    surplus: tuple[Scaled, ...] = ()
    missing: tuple[Scaled, ...] = ()
    seeds: tuple[int, ...] = ()


def make_pair(plan: PairPlan, seed: int, number: int) -> Pair:
    """Make a pair of the two physics, the same for the same seed and number.

    Raises
    ------
    Refused
        When no runs are found that show the causes.
    """
    rng = np.random.default_rng([seed, number])
    draws = {"mistake": _mistaken, "runs": _two_runs}
    draw = draws.get(plan.kind, _two_physics)
    for _ in range(_TRIES):
        sides = draw(rng, plan)
        if sides is not None:
            return _pair_of(rng, plan, sides)
    raise Refused(f"no runs were found in which {' and '.join(plan.effects)} can be seen")


def _two_physics(rng: Generator, plan: PairPlan) -> _Sides | None:
    """Draw a recording and a simulation with their causes; None where these cannot be seen."""
    entries = [CAUSES[effect] for effect in plan.effects]
    motions = tuple(one for one in MOVING if all(one in entry.motions for entry in entries[: len(plan.missing)]))
    recording = draw_recording(rng, motions, coarse=any(entry.coarse for entry in entries))
    if plan.detail:
        noise = (louder if plan.kind == "level" else coloured)(rng, recording.noise, plan.detail)
        recording = replace(recording, noise=noise)
    seeds = tuple(int(one) for one in rng.integers(2**31, size=len(plan.effects)))
    gaps = dict(zip(plan.effects, plan.gaps, strict=False))
    missing = _causes(recording, plan.missing, gaps, seeds)
    if missing is None:
        return None
    simulation = draw_simulation(rng, recording.scene, is_alike=plan.is_mended or plan.kind == "other")
    surplus = (
        tuple(_again(simulation, cause, seed, 1 / TIMES) for cause, seed in zip(missing, seeds, strict=False))
        if plan.kind == "other"
        else _causes(simulation, plan.surplus, gaps, seeds[len(plan.missing) :])
    )
    if surplus is None or None in surplus:
        return None
    return _Sides(simulation, recording, tuple(one for one in surplus if one), missing, seeds)


def _causes(
    run: Run, effects: tuple[str, ...], gaps: dict[str, float], seeds: tuple[int, ...]
) -> tuple[Scaled, ...] | None:
    """Return causes at their gaps in a run; None where one cannot be seen, or two cannot be told apart."""
    if not effects:
        return ()
    model, causes = NominalModel(run.scene), []
    for effect, seed in zip(effects, seeds, strict=False):
        disturbance = CAUSES[effect].draw(np.random.default_rng(seed), run.scene)
        cause = scale_to(model, disturbance, gaps[effect], run.seen)
        if cause is None or not case.is_natural(cause, run.scene) or not case.can_be_seen(model, cause):
            return None
        causes.append(cause)
    return tuple(causes) if len(causes) < 2 or case.are_unlike(model, causes, apart=False) else None


def _again(run: Run, cause: Scaled, seed: int, times: float) -> Scaled | None:
    """Return a cause of one run in another, at so many times its amplitude; None where its place is another."""
    disturbance = CAUSES[cause.disturbance.effect].draw(np.random.default_rng(seed), run.scene)
    if (disturbance.sensors, disturbance.axes) != (cause.disturbance.sensors, cause.disturbance.axes):
        return None
    signal = disturbance.change(times * cause.amplitude, run.seen)
    return Scaled(disturbance, times * cause.amplitude, signal, NominalModel(run.scene).visible_gap(signal))


def _two_runs(rng: Generator, plan: PairPlan) -> _Sides | None:
    """Draw two runs of one simulator, which differ in path and noise alone."""
    like = draw_recording(rng, MOVING).scene
    vehicle = draw_vehicle(rng, like)
    first, second = (run_of(rng, replace(vehicle, seed=vehicle.seed + number)) for number in range(2))
    return _Sides(first, second) if first.is_informative and second.is_informative else None


def _mistaken(rng: Generator, plan: PairPlan) -> _Sides | None:
    """Draw a recording in a world of east, north, up, and a simulation of its site with a mistake."""
    recording = draw_recording(rng, MOVING)
    field_T = draw_field(rng, least_dip=45.0)
    scene = replace(recording.scene, world_field=lambda at_s: np.tile(field_T, (len(at_s), 1)))
    recording = replace(recording, scene=scene)
    vehicle = replace(draw_vehicle(rng, scene), field_T=field_T)
    if not recording.is_informative or not run_of(rng, vehicle).is_informative:
        return None
    if plan.detail == "same_noise_in_runs":
        vehicle = replace(vehicle, noise_seed=vehicle.seed)
        recording = run_of(rng, replace(vehicle, seed=vehicle.seed + 1))
    simulation = run_of(rng, mistaken_vehicle(rng, vehicle, plan.detail))
    return _Sides(mistaken_run(rng, simulation, plan.detail), recording)


def _pair_of(rng: Generator, plan: PairPlan, sides: _Sides) -> Pair:
    """Return what goes to files."""
    sheet, scene = case.draw_sheet(rng), sides.recording.scene
    noises = {"simulation": sides.simulation.noise, "recording": sides.recording.noise}
    key = {
        "kind": plan.kind,
        "detail": plan.detail,
        "gap": plan.gaps[0] if len(plan.gaps) == 1 else None,
        "missing": [case.cause_key(cause) for cause in sides.missing],
        "surplus": [case.cause_key(cause) for cause in sides.surplus],
        "noise_nT": {name: levels_nT(noise) for name, noise in noises.items()},
        "samples": scene.sample_count,
        "rate_hz": 1 / scene.step_s,
        "motion": scene.motion.kind,
        "stated_noise_nT": to_nanotesla(scene.vector_noise_T) / sheet[0],
    }
    simulation = mistaken_columns(rng, _columns(rng, sides.simulation, sides.surplus), plan.detail)
    recording = _columns(rng, sides.recording, sides.missing)
    return Pair(simulation, recording, case.array_of(scene, sheet), key, _mended(rng, plan, sides))


def _mended(rng: Generator, plan: PairPlan, sides: _Sides) -> Columns | None:
    """Return the simulation with the effect that it lacks; None where that is no question, or not the same effect."""
    if not plan.is_mended:
        return None
    cause = _again(sides.simulation, sides.missing[0], sides.seeds[0], 1.0)
    return None if cause is None else _columns(rng, sides.simulation, (cause,))


def _columns(rng: Generator, run: Run, causes: tuple[Scaled, ...]) -> Columns:
    return case.columns_of(rng, run.scene, PLAIN, case.with_causes(run.seen, list(causes)))
