"""A bias that jumps, once or on and off."""

from collections.abc import Iterable, Iterator, Mapping
from typing import ClassVar

import numpy as np

from tam_calibration.effects.change_points import Path, without
from tam_calibration.effects.effect import (
    Coefficient,
    Limit,
    LinearEffect,
    Misfit,
    Shape,
    Situation,
    SurrogateKind,
    Term,
)
from tam_calibration.effects.grades import LEAST_SAMPLES, NEGLIGIBLE
from tam_calibration.effects.moved_sphere import moved_sphere
from tam_calibration.effects.saturation import inside_range
from tam_calibration.effects.spikes import without_spikes_of_motion

_MOST_OF_ROWS = 3
"""Rows, those in which a jump explains most, whose times are tried for all."""


class BiasJump(LinearEffect):
    """Offsets of axes change at one time, for good or until another time."""

    name: ClassVar[str] = "bias_jump"
    title: ClassVar[str] = "bias that jumps"
    physics: ClassVar[str] = (
        "A magnet or tool that comes near, a shock to magnetised parts or an electronic reset changes the bias at once "
        "(Ripka, Magnetic Sensors and Magnetometers, Artech House, 2001: perming); its time is where the cumulative "
        "sum of the residuals turns (Page, Continuous inspection schemes, Biometrika 41, 1954, p. 100)."
    )
    excitation: ClassVar[str] = "turn through the same attitudes before and after the jump"
    is_free_in_time: ClassVar[bool] = True
    is_step: ClassVar[bool] = True
    may_repeat: ClassVar[bool] = True
    has_exact_shapes: ClassVar[bool] = True
    surrogates: ClassVar[SurrogateKind] = "at_other_times"
    shape_units: ClassVar[dict[str, str]] = {"time_s": "s", "end_s": "s"}
    limits: ClassVar[Mapping[str, Limit]] = {
        "offset": Limit(
            1e-2,
            "a magnet of 1 cm of neodymium iron boron makes 8 mT at 3 cm; Furlani, Permanent Magnet and "
            "Electromechanical Devices, Academic Press, 2001, chapter 4",
            "T",
        )
    }

    def obstacle(self, situation: Situation) -> str | None:
        """Return that the recording is too short, where it is."""
        if situation.sample_count < LEAST_SAMPLES:
            return f"{situation.sample_count} samples are too few to tell a jump"
        return None

    def shapes(self, situation: Situation, misfit: Misfit) -> Iterable[Shape]:
        """Return the times, and pairs of times, at which jumps of one row or of all explain most, of all samples.

        What an axis reads at the end of its range is no jump, nor are spikes that come with the motion.
        """
        if situation.sample_count < LEAST_SAMPLES:
            return []
        intensity = float(np.median(situation.intensity_T))
        middle = (situation.time_s[1:] + situation.time_s[:-1]) / 2
        whole, *rows = (path.best() for path in _paths(without_spikes_of_motion(inside_range(misfit))))
        ranked = [sorted((row[kind] for row in rows), key=lambda jump: -jump.gain)[:_MOST_OF_ROWS] for kind in range(2)]
        cuts = dict.fromkeys(jump.cuts for jump in (*whole, *ranked[0], *ranked[1]) if jump.gain > 0)
        shapes: list[Shape] = [
            dict(zip(self.shape_units, (float(middle[cut]) for cut in found), strict=False)) for found in cuts
        ]
        is_small = situation.follows_attitude or np.sqrt(np.mean(misfit.row_shift_T**2)) < NEGLIGIBLE * intensity
        gross = None if is_small else moved_sphere(misfit.recording)
        return shapes if gross is None else [gross.shape, *shapes]

    def always(self, shape: Shape) -> Shape | None:
        """Return a jump that was there before the first sample."""
        return {"time_s": -np.inf}

    def terms(self, situation: Situation, shape: Shape) -> list[Term]:
        """Return an offset of each row from the one time on, until the other where there is one."""
        is_off = (situation.time_s < shape["time_s"]) | (situation.time_s >= shape.get("end_s", np.inf))
        step = np.where(is_off, 0.0, 1.0)[:, None]
        parts = [Coefficient("offset", "T")]
        return [Term.of_row(situation, row, "offset", parts, step) for row in range(situation.scalar_row + 1)]


def _paths(misfit: Misfit) -> Iterator[Path]:
    """Yield the path of jumps anywhere in the differential channels, then that of each row alone."""
    counted = misfit.is_counted
    direction = misfit.situation.field_T / misfit.situation.intensity_T[:, None]
    constant = np.column_stack([counted, counted[:, None] * direction])
    own = np.where(counted[:, None], misfit.differential, 0)
    between = Path.of(*without(own, constant), counted[:, None].astype(float))
    has_reference = counted & np.isfinite(misfit.common_mode)
    common = np.where(has_reference, misfit.common_mode, 0)
    slope = np.where(has_reference[:, None], misfit.row_slope, 0)
    first, second = np.triu_indices(3)
    functions = np.column_stack([direction, direction[:, first] * direction[:, second]]) * slope[:, -1:]
    norms = np.append(np.sum(misfit.directions**2, axis=1), 0)
    common_left, basis = without(common[:, None], functions)
    if between.score.shape[2]:
        yield between
    for row, norm in enumerate(norms):
        path = Path.of(common_left, basis, slope[:, row, None])
        score = path.score
        if row < len(misfit.directions):
            score = score + between.score @ misfit.directions[row][:, None]
        nuisance = np.concatenate([np.sqrt(norm) * between.nuisance, path.nuisance], axis=1)
        yield Path(score, norm * between.information + path.information, nuisance)
