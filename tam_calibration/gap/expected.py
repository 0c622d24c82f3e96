"""What a recording that could be made would tell, by simulation without noise."""

from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.effects.effect import ALL, SCALAR, LinearEffect, Shape, Situation, Term
from tam_calibration.gap.candidates import Candidate
from tam_calibration.gap.channels import Channels
from tam_calibration.gap.model import Model, Part
from tam_calibration.gap.regression import Base
from tam_calibration.recording import Recording
from tam_calibration.units import FloatArray

_MOST_SHAPES = 12
"""Of an effect that are tried on a simulated recording."""


@dataclass(frozen=True, eq=False)
class Setting:
    """What simulations of other recordings need of this one."""

    model: Model
    situation: Situation
    variance: float

    def channels(self, situation: Situation, added_T: FloatArray | float = 0.0) -> Channels:
        """Return the channels of a recording without noise in which something is added to the rows."""
        rows = np.column_stack(
            [situation.errors.distort(situation.field_T).reshape(situation.sample_count, -1), situation.intensity_T]
        )
        rows = rows + added_T
        scalar = self.model.recording.scalar_T
        if scalar is not None:
            apart = max(round(1 / float(np.mean(np.isfinite(scalar)))), 1)
            rows[np.arange(len(rows)) % apart != 0, -1] = np.nan
        readings = rows[:, :-1].reshape(len(rows), -1, 3)
        recording = Recording(
            situation.time_s,
            readings,
            rows[:, -1],
            situation.temperature_C,
            situation.current_A,
            situation.attitude,
        )
        model = self.model
        world = None if situation.attitude is None or model.world is None else model.world.aligned
        return Channels.at(recording, model.array, model.errors, model.intensity_T, world=world)

    @property
    def minutes(self) -> float:
        """Duration of the recording at hand."""
        return float(np.ptp(self.situation.time_s)) / 60

    def samples_per_simulated(self, candidate: Candidate, count: int) -> float:
        """Return how many samples of the real recording stand behind one of so many simulated."""
        return 60 * candidate.minutes / self.situation.step_s / count


def expected_evidence(setting: Setting, first: Part, second: Part, candidate: Candidate, is_nested: bool) -> float:
    """Return the smaller of the expected evidences of either hypothesis, were it true, against the other."""
    situation = candidate.situation(setting.situation, {*first.effect.channels, *second.effect.channels})
    left = _left(setting, situation, first, second)
    if not is_nested:
        left = min(left, _left(setting, situation, second, first))
    return left * setting.samples_per_simulated(candidate, situation.sample_count) / setting.variance


def _left(setting: Setting, situation: Situation, truth: Part, other: Part) -> float:
    """Return the energy of one effect that the calibration and another effect in any form leave."""
    if truth.effect.obstacle(situation) is not None:
        return 0.0
    channels = setting.channels(situation, signal_of(setting, situation, truth))
    base = Base(channels, [channels.calibration])
    if other.effect.obstacle(channels.situation) is not None:
        return base.energy
    tried = [other.shape, *other.effect.shapes(channels.situation, channels.misfit)]
    gains = [
        base.project(channels.design(terms)).gain()[0]
        for terms in (_terms(setting, other.effect, channels.situation, shape) for shape in tried[:_MOST_SHAPES])
    ]
    return max(base.energy - max(gains), 0.0)


def signal_of(setting: Setting, situation: Situation, truth: Part) -> FloatArray:
    """Return what an effect adds to the rows; what happened at some time happens at that part of the recording."""
    if truth.effect.is_free_in_time:
        before = setting.situation.time_s
        situation = replace(situation, time_s=np.linspace(before[0], before[-1], situation.sample_count))
    found = {(term.sensor, term.axis, term.name): term for term in truth.effect.terms(situation, truth.shape)}
    return truth.signal([found[key] for key in truth.keys], situation.scalar_row + 1)


def _terms(setting: Setting, effect: LinearEffect, situation: Situation, shape: Shape) -> list[Term]:
    has_scalar = setting.model.recording.scalar_T is not None
    return [term for term in effect.terms(situation, shape) if term.sensor != SCALAR or effect.is_of_site or has_scalar]


def visible_part(setting: Setting, effect: LinearEffect, candidate: Candidate, sensors: set[int]) -> float:
    """Return the part of what an effect adds at some sensors that the calibration cannot take for its own."""
    situation = candidate.situation(setting.situation, effect.channels)
    if effect.obstacle(situation) is not None:
        return 0.0
    seen = setting.channels(situation)
    shapes = list(effect.shapes(situation, seen.misfit))
    terms = _terms(setting, effect, situation, shapes[len(shapes) // 2]) if shapes else []
    own = [term for term in terms if term.sensor in sensors or ALL in sensors | {term.sensor}]
    if not own:
        return 0.0
    projected = Base(seen, [seen.calibration]).project(seen.design(own))
    shown = np.diag(projected.information) / np.maximum(projected.before, np.finfo(float).tiny)
    return float(np.median(np.clip(shown, 0, 1)))
