"""One recording with a known cause: drawn, made, what is given out of it, and its key."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator

from tam_calibration.model.exceptions import Refused
from tam_calibration.model.units import FloatArray, from_degrees, to_nanotesla
from tam_validation.blind.case_plan import CasePlan
from tam_validation.blind.catalogue import CAUSES, CHANNELS, LAWS
from tam_validation.blind.continuous_motion import MOTIONS
from tam_validation.blind.disturbance import ALL, Signal
from tam_validation.blind.scene import Scene, Wish, draw_scene
from tam_validation.blind.visible import NominalModel, Scaled, scale_to


def columns_of(rng: Generator, scene: Scene, plan: CasePlan, recorded: Signal) -> dict[str, FloatArray]:
    """Return the columns of the recording, the deciding channel left out when it is withheld."""
    vectors, scalar = recorded
    columns = {"time_s": scene.time_s}
    for sensor in range(scene.sensor_count):
        for axis, name in enumerate("xyz"):
            columns[f"b{sensor + 1}{name}_nT"] = to_nanotesla(vectors[:, sensor, axis])
    if scene.with_scalar:
        columns["scalar_nT"] = to_nanotesla(scalar)
    beside = set(scene.channels) - {plan.withheld}
    if "temperature" in beside:
        error_C = rng.normal(size=scene.sample_count) * rng.uniform(0.005, 0.05)
        columns["temperature_C"] = np.round(scene.temperature(scene.time_s) + error_C, 3)
    if "current" in beside:
        error_A = rng.normal(size=scene.sample_count) * rng.uniform(0.005, 0.03)
        columns["current_A"] = np.round(scene.current(scene.time_s) + error_A, 4)
    if "attitude" in beside:
        error = rng.normal(size=(scene.sample_count, 3)) * from_degrees(rng.uniform(0.01, 0.1))
        columns |= dict(zip(("qx", "qy", "qz", "qw"), _quaternions(scene.to_world, error).T, strict=True))
    return columns


def _quaternions(to_world: FloatArray, error: FloatArray) -> FloatArray:
    """Return the recorded attitudes (N, 4), x, y, z, w, turned by small errors."""
    from scipy.spatial.transform import Rotation

    return np.asarray((Rotation.from_matrix(to_world) * Rotation.from_rotvec(error)).as_quat())


def array_of(scene: Scene, sheet: FloatArray) -> dict[str, Any]:
    """Return the array file: the geometry, the data sheet's noise, how it was recorded."""
    arm = float(np.abs(scene.positions_m).max())
    geometry = {"baseline_m": 2 * arm} if scene.sensor_count == 4 else {"positions_m": scene.positions_m.tolist()}
    noise = {"vector_noise_nT": to_nanotesla(scene.vector_noise_T) / sheet[0]}
    if scene.with_scalar:
        noise["scalar_noise_nT"] = to_nanotesla(scene.scalar_noise_T) / sheet[1]
    recording = {"motion": scene.motion.kind, "rate_hz": 1 / scene.step_s}
    return geometry | {name: float(f"{value:.6g}") for name, value in noise.items()} | {"recording": recording}


def key_of(plan: CasePlan, scene: Scene, causes: list[Scaled], gap: float, sheet: FloatArray) -> dict[str, Any]:
    """Return the key: the causes with all that was drawn for them, and the conditions of the recording."""
    holes = bool((np.diff(scene.time_s) > 1.5 * scene.step_s).any())
    return {
        "kind": plan.kind,
        "effects": [cause_key(cause) for cause in causes],
        "visible_gap": gap,
        "withheld_channel": plan.withheld,
        "identifiable": plan.kind not in ("withheld", "short"),
        "samples": scene.sample_count,
        "sensors": scene.sensor_count,
        "motion": scene.motion.kind,
        "with_scalar": scene.with_scalar,
        "holes": holes,
        "noise_over_sheet": {"vector": float(sheet[0]), "scalar": float(sheet[1])},
        "vector_noise_nT": to_nanotesla(scene.vector_noise_T),
        "scalar_noise_nT": to_nanotesla(scene.scalar_noise_T),
    }


def cause_key(cause: Scaled) -> dict[str, Any]:
    """Return what the key says of a cause: place, size, all that was drawn, and what it may be called."""
    disturbance = cause.disturbance
    entry = CAUSES[disturbance.effect]
    struck = int((np.abs(cause.signal[0]).sum(axis=(1, 2)) + np.abs(cause.signal[1]) > 0).sum())
    return {
        "effect": disturbance.effect,
        "sensors": list(disturbance.sensors),
        "axes": list(disturbance.axes),
        "visible_gap": cause.visible_gap,
        "amplitude": cause.amplitude,
        "amplitude_unit": disturbance.amplitude_unit,
        "samples_changed": struck,
        "parameters": disturbance.parameters,
        "coefficients": {name: value * cause.amplitude for name, value in disturbance.coefficients.items()},
        "named": entry.named,
        **LAWS[disturbance.effect],
    }


WELL_CONDITIONED = 1e-3
"""Least singular value of the nominal parameters' design over the largest: below, the calibration is undetermined."""

_HIDDEN = 0.03
"""Share of a signal that the nominal fit must leave: with less the recording cannot show it."""

FEW_CLIPPED = 4
"""Least number of clipped samples: fewer cannot be told from outliers."""

_LEAST_SPIKE = 4.0
"""Spikes smaller than this many noise floors are noise, not outliers."""

_TRIES = 1000
"""Draws of a recording in which the causes can be seen, before that is given up; they take some twenty seconds."""

_MOST_CORRELATION = 0.6
"""Largest cosine between the visible signals of two causes: above, no diagnosis can separate them."""


@dataclass(frozen=True, eq=False)
class Case:
    """A case as it goes to files: the table of the recording, the array file's content, the key."""

    columns: dict[str, FloatArray]
    array: dict[str, Any]
    key: dict[str, Any]


def make_case(plan: CasePlan, seed: int, number: int) -> Case:
    """Make one case, the same for the same seed and number.

    Raises
    ------
    Refused
        When no recording can be found that shows the causes.
    """
    rng = np.random.default_rng([seed, number])
    for _ in range(_TRIES):
        made = _try(rng, plan)
        if made is not None:
            return made
    raise Refused(f"no recording was found in which {' and '.join(plan.effects)} can be seen and told apart")


def _try(rng: Generator, plan: CasePlan) -> Case | None:
    """Draw a recording and its causes; None when the causes cannot be seen or told apart in it."""
    scene = draw_scene(rng, _draw_wish(rng, plan))
    model = NominalModel(scene)
    if model.conditioning < WELL_CONDITIONED:
        return None
    noise = draw_noise(rng, scene)
    seen = (scene.readings_T + noise[0], scene.intensity_T + noise[1])
    causes: list[Scaled] = []
    for effect, gap in zip(plan.effects, plan.gaps, strict=True):
        scaled = scale_to(model, CAUSES[effect].draw(rng, scene), gap, seen)
        if scaled is None or not is_natural(scaled, scene) or not can_be_seen(model, scaled):
            return None
        causes.append(scaled)
    if len(causes) == 2 and not are_unlike(model, causes, apart=plan.kind == "mixed"):
        return None
    recorded = with_causes(seen, causes)
    signal = (recorded[0] - seen[0], recorded[1] - seen[1])
    sheet = draw_sheet(rng)
    own = {name: values for cause in causes for name, values in cause.disturbance.columns.items()}
    return Case(
        columns_of(rng, scene, plan, recorded) | own,
        array_of(scene, sheet),
        key_of(plan, scene, causes, model.visible_gap(signal), sheet),
    )


def _draw_wish(rng: Generator, plan: CasePlan) -> Wish:
    """Draw a recording that can show the causes."""
    entries = [CAUSES[effect] for effect in plan.effects]
    counts = [count for count in (1, 2, 3, 6) if all(count in entry.sensor_counts for entry in entries)]
    if plan.kind == "pair":
        counts = [count for count in counts if count >= 3]
    other_array = rng.random() < 0.15
    sensor_count = int(rng.choice(counts)) if other_array and counts else 4
    without = rng.random() < 0.12 and sensor_count >= 3
    allowed = [entry.motions for entry in entries] or [MOTIONS]
    motions = [motion for motion in MOTIONS if all(motion in each for each in allowed)]
    few = plan.kind == "short"
    recorded = {channel for channel in CHANNELS if rng.random() < 0.5} | {entry.channel for entry in entries} - {""}
    drawn = int(rng.integers(60, 201)) if few else int(360 * (4000 / 360) ** rng.random())
    return Wish(
        samples=plan.samples or drawn,
        sensor_count=sensor_count,
        motions=tuple(motions),
        with_scalar=not without or any(entry.scalar_needed for entry in entries),
        with_holes=bool(rng.random() < 0.15),
        channels=tuple(sorted(recorded)),
        coarse=plan.kind != "large" and any(entry.coarse for entry in entries),
    )


def draw_noise(rng: Generator, scene: Scene) -> Signal:
    """Draw the white noise of all readings and of the scalar."""
    vectors = rng.normal(size=scene.readings_T.shape) * scene.vector_noise_T
    return vectors, rng.normal(size=scene.sample_count) * scene.scalar_noise_T


def can_be_seen(model: NominalModel, scaled: Scaled) -> bool:
    """Whether the nominal fit leaves a visible part of a signal."""
    vectors, scalar = scaled.signal
    whole = np.concatenate([vectors.reshape(len(vectors), -1), scalar[:, None]], axis=1) * model.weights
    struck = np.abs(whole).sum(axis=1) > 0
    effect = scaled.disturbance.effect
    if effect == "saturation" and struck.sum() < FEW_CLIPPED:
        return False
    if effect == "outliers" and norm(whole[struck], axis=1).min() < _LEAST_SPIKE:
        return False
    whole = whole - whole.mean(axis=0)
    return float(norm(model.left(scaled.signal))) > _HIDDEN * float(norm(whole))


def is_natural(scaled: Scaled, scene: Scene) -> bool:
    """Whether a cause changes no reading by more, nor faster, than it does in nature."""
    entry = CAUSES[scaled.disturbance.effect]
    largest_T = max(float(np.abs(part).max()) for part in scaled.signal)
    if to_nanotesla(largest_T) > entry.most_nT:
        return False
    if np.isinf(entry.most_nT_per_s):
        return True
    step_s = np.diff(scene.time_s)
    rates = [np.diff(part.reshape(len(part), -1), axis=0) / step_s[:, None] for part in scaled.signal]
    return bool(to_nanotesla(max(np.sqrt(np.mean(rate**2)) for rate in rates)) <= entry.most_nT_per_s)


def are_unlike(model: NominalModel, causes: list[Scaled], apart: bool) -> bool:
    """Say whether two causes leave unlike signals, and are not of one family at one place; apart: nor at one place."""
    families = {CAUSES[one.disturbance.effect].family for one in causes}
    places = [{*one.disturbance.sensors} for one in causes]
    if (apart or len(families) == 1) and (places[0] & places[1] or ALL in places[0] | places[1]):
        return False
    first, second = (model.left(cause.signal).ravel() for cause in causes)
    return bool(abs(first @ second) < _MOST_CORRELATION * norm(first) * norm(second))


def with_causes(seen: Signal, causes: list[Scaled]) -> Signal:
    """Add the causes: first what acts on the sensors, then what the recorder does to the sum."""
    vectors, scalar = seen
    for cause in sorted(causes, key=lambda cause: cause.disturbance.after_noise):
        change = cause.signal
        if cause.disturbance.after_noise:
            change = cause.disturbance.change(cause.amplitude, (vectors, scalar))
        vectors, scalar = vectors + change[0], scalar + change[1]
    return vectors, scalar


def draw_sheet(rng: Generator) -> FloatArray:
    """Draw the ratio of the true noise to that of the data sheet, for vectors and scalar."""
    return np.ones(2) if rng.random() < 0.3 else rng.uniform(0.88, 1.12, 2)
