"""Recordings that could be made next, and what they would tell, by simulation without noise."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tam_calibration.effects.covariates import Covariates, to_world
from tam_calibration.effects.effect import LinearEffect
from tam_calibration.effects.term import Term
from tam_calibration.gap.model import Model, Part
from tam_calibration.gap.regression import Base
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.fitted_effect import ALL, SCALAR, Shape
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray

SAMPLES = 600
"""Of a simulated recording; what they tell is told of as many samples as the real one would have."""

_FAST_S = 5.0
"""Seconds of a fast turn, and for which a pose is held: what hands do."""

_SLOWER = 8.0
"""How many times longer a slow turn takes, so that what follows the rate is small."""

_LEAST_SAMPLES_PER_TURN = 16
"""With fewer a motion is no longer told from its samples."""

_RAMPS = 2
"""Times that the temperature goes down and up, so that it is no drift in time."""

_LEAST_RISE_K = 5.0
"""Kelvin; what a box in the sun or a refrigerator makes at least."""

_SWITCHINGS = 12
"""Times that the current is switched, each at other attitudes."""

_LEAST_CURRENT_A = 1.0
"""Amperes; where the recording tells of no larger change."""

Path = Literal["onwards", "back and forth", "swings", "poses"]


@dataclass(frozen=True)
class Candidate:
    """A recording that could be made.

    Parameters
    ----------
    words : str
        What to do, as an order.
    path : str
        How the array goes along the path of a tumble through all directions, or the poses of a turntable.
    turn_s : float
        Duration of a turn, or of a pose.
    minutes : float
        How long.
    changes : tuple of str
        Channels of ``Recording`` that are changed meanwhile.
    """

    words: str
    path: Path
    turn_s: float
    minutes: float
    changes: tuple[str, ...] = ()

    def covariates(self, now: Covariates, channels: Collection[str], count: int = SAMPLES) -> Covariates:
        """Return what would happen to the array of a recording, with some of the channels, at so many samples.

        Temperature and current stay as they are, unless they are changed on purpose.
        """
        from scipy.spatial.transform import Rotation

        # Of a pose that is held one sample tells all; the way from pose to pose is nobody's to foresee.
        count = count if self.path != "poses" else round(60 * self.minutes / self.turn_s)
        time = np.linspace(0, 60 * self.minutes, count, endpoint=False)
        attitude = self._attitude(time)
        field = Rotation.from_quat(attitude).inv().apply(_world_field(now))
        phase = np.arange(count) / count
        middle, rise = _level(now.temperature_C, _LEAST_RISE_K, 20.0)
        ramps = np.abs((2 * _RAMPS * phase) % 2 - 1) - 0.5 if "temperature_C" in self.changes else np.zeros(count)
        temperature = middle + rise * ramps
        middle, rise = _level(now.current_A, _LEAST_CURRENT_A, _LEAST_CURRENT_A / 2)
        switched = (_SWITCHINGS * phase).astype(int) % 2 - 0.5 if "current_A" in self.changes else np.zeros(count)
        current = middle + rise * switched
        return Covariates(
            now.time_s[0] + time,
            field,
            now.errors,
            now.array,
            temperature if "temperature_C" in channels else None,
            current if "current_A" in channels else None,
            attitude if "attitude" in channels else None,
        )

    def _attitude(self, time_s: FloatArray) -> FloatArray:
        from tam_calibration.simulation.attitude import Tumble, Turntable

        generator, whole = np.random.default_rng(0), 60 * self.minutes
        if self.path == "poses":
            poses: FloatArray = Turntable().attitudes(np.arange(whole / self.turn_s), generator)
            held: FloatArray = poses[(time_s / self.turn_s).astype(int)]
            return held
        along = {
            "onwards": time_s,
            "back and forth": np.minimum(time_s, whole - time_s),
            "swings": 0.2 * time_s
            + 0.5 * self.turn_s * time_s / whole * np.sin(2 * np.pi * time_s / (3 * self.turn_s)),
        }[self.path]
        return Tumble(2 * np.pi / self.turn_s).attitudes(along, generator)


def candidates(now: Covariates, channels: Collection[str]) -> list[Candidate]:
    """Return recordings that are worth a thought where effects need some channels."""
    fast = max(_FAST_S, _LEAST_SAMPLES_PER_TURN * now.step_s)
    slow = _SLOWER * fast
    onwards = f"turn it slowly and steadily through all directions ({slow:.0f} s a turn)"
    meanwhile = {}
    if "temperature_C" in channels:
        _, rise = _level(now.temperature_C, _LEAST_RISE_K, 0.0)
        meanwhile["temperature_C"] = f"the temperature goes down and up {rise:.0f} K twice"
    if "current_A" in channels:
        _, rise = _level(now.current_A, _LEAST_CURRENT_A, 0.0)
        meanwhile["current_A"] = f"the current is switched by {rise:.2g} A, {_SWITCHINGS} times"
    if meanwhile:
        turns = 30 if "temperature_C" in meanwhile else 10
        words = f"{onwards} while {' and '.join(meanwhile.values())}"
        return [Candidate(words, "onwards", slow, turns * slow / 60, tuple(meanwhile))]
    return [
        Candidate(onwards, "onwards", slow, 10 * slow / 60),
        Candidate(
            f"turn it fast through all directions ({fast:.0f} s a turn), then the same way back",
            "back and forth",
            fast,
            20 * fast / 60,
        ),
        Candidate(
            f"turn it through all directions in swings back and forth, small and large, of {3 * fast:.0f} s each",
            "swings",
            fast,
            20 * fast / 60,
        ),
        Candidate(f"hold it still in 72 poses on all sides, {_FAST_S:.0f} s each", "poses", _FAST_S, 72 * _FAST_S / 60),
    ]


def _world_field(now: Covariates) -> FloatArray:
    """Return the field (3,) of the world: as the attitudes tell, or that of middle latitudes."""
    if now.attitude is None:
        direction = np.array([0.0, 0.5, -np.sqrt(0.75)])
    else:
        direction = np.einsum("nij,nj->i", to_world(now), now.field_T)
    field: FloatArray = float(np.mean(now.intensity_T)) * direction / np.linalg.norm(direction)
    return field


def _level(channel: FloatArray | None, least: float, otherwise: float) -> tuple[float, float]:
    """Return the middle of a channel's range and its width, no less than so much."""
    if channel is None:
        return otherwise, least
    low, high = float(channel.min()), float(channel.max())
    return (low + high) / 2, max(high - low, least)


_MOST_SHAPES = 12
"""Of an effect that are tried on a simulated recording."""


@dataclass(frozen=True, eq=False)
class Setting:
    """What simulations of other recordings need of this one."""

    model: Model
    covariates: Covariates
    variance: float

    def channels(self, covariates: Covariates, added_T: FloatArray | float = 0.0) -> WhitenedChannels:
        """Return the channels of a recording without noise in which something is added to the rows."""
        rows = np.column_stack(
            [covariates.errors.distort(covariates.field_T).reshape(covariates.sample_count, -1), covariates.intensity_T]
        )
        rows = rows + added_T
        scalar = self.model.recording.scalar_T
        if scalar is not None:
            apart = max(round(1 / float(np.mean(np.isfinite(scalar)))), 1)
            rows[np.arange(len(rows)) % apart != 0, -1] = np.nan
        readings = rows[:, :-1].reshape(len(rows), -1, 3)
        recording = Recording(
            covariates.time_s,
            readings,
            rows[:, -1],
            covariates.temperature_C,
            covariates.current_A,
            covariates.attitude,
        )
        model = self.model
        world = None if covariates.attitude is None or model.world is None else model.world.aligned
        return WhitenedChannels.at(recording, model.array, model.errors, model.intensity_T, world=world)

    @property
    def minutes(self) -> float:
        """Duration of the recording at hand."""
        return float(np.ptp(self.covariates.time_s)) / 60

    def samples_per_simulated(self, candidate: Candidate, count: int) -> float:
        """Return how many samples of the real recording stand behind one of so many simulated."""
        return 60 * candidate.minutes / self.covariates.step_s / count


def expected_evidence(setting: Setting, first: Part, second: Part, candidate: Candidate, is_nested: bool) -> float:
    """Return the smaller of the expected evidences of either hypothesis, were it true, against the other."""
    covariates = candidate.covariates(setting.covariates, {*first.effect.channels, *second.effect.channels})
    left = _left(setting, covariates, first, second)
    if not is_nested:
        left = min(left, _left(setting, covariates, second, first))
    return left * setting.samples_per_simulated(candidate, covariates.sample_count) / setting.variance


def _left(setting: Setting, covariates: Covariates, truth: Part, other: Part) -> float:
    """Return the energy of one effect that the calibration and another effect in any form leave."""
    if truth.effect.obstacle(covariates) is not None:
        return 0.0
    channels = setting.channels(covariates, signal_of(setting, covariates, truth))
    base = Base(channels, [channels.calibration])
    if other.effect.obstacle(channels.covariates) is not None:
        return base.energy
    tried = [other.shape, *other.effect.shapes(channels.covariates, channels.residuals)]
    gains = [
        base.project(channels.design(terms)).gain()[0]
        for terms in (_terms(setting, other.effect, channels.covariates, shape) for shape in tried[:_MOST_SHAPES])
    ]
    return max(base.energy - max(gains), 0.0)


def signal_of(setting: Setting, covariates: Covariates, truth: Part) -> FloatArray:
    """Return what an effect adds to the rows; what happened at some time happens at that part of the recording."""
    if truth.effect.is_free_in_time:
        before = setting.covariates.time_s
        covariates = replace(covariates, time_s=np.linspace(before[0], before[-1], covariates.sample_count))
    found = {(term.sensor, term.axis, term.name): term for term in truth.effect.terms(covariates, truth.shape)}
    return truth.signal([found[key] for key in truth.keys], covariates.scalar_row + 1)


def _terms(setting: Setting, effect: LinearEffect, covariates: Covariates, shape: Shape) -> list[Term]:
    has_scalar = setting.model.recording.scalar_T is not None
    return [
        term for term in effect.terms(covariates, shape) if term.sensor != SCALAR or effect.is_of_site or has_scalar
    ]


def visible_part(setting: Setting, effect: LinearEffect, candidate: Candidate, sensors: set[int]) -> float:
    """Return the part of what an effect adds at some sensors that the calibration cannot take for its own."""
    covariates = candidate.covariates(setting.covariates, effect.channels)
    if effect.obstacle(covariates) is not None:
        return 0.0
    seen = setting.channels(covariates)
    shapes = list(effect.shapes(covariates, seen.residuals))
    terms = _terms(setting, effect, covariates, shapes[len(shapes) // 2]) if shapes else []
    own = [term for term in terms if term.sensor in sensors or ALL in sensors | {term.sensor}]
    if not own:
        return 0.0
    projected = Base(seen, [seen.calibration]).project(seen.design(own))
    shown = np.diag(projected.information) / np.maximum(projected.before, np.finfo(float).tiny)
    return float(np.median(np.clip(shown, 0, 1)))
