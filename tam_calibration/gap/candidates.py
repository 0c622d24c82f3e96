"""Recordings that could be made next, and the evidence expected of each, by simulation without noise."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tam_calibration.effects.covariates import Covariates, to_world
from tam_calibration.effects.effect import LinearEffect
from tam_calibration.effects.term import Term, chosen
from tam_calibration.gap.model import Model, Part
from tam_calibration.gap.regression import Base
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.fitted_effect import ALL, SCALAR, Shape
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray

SAMPLES = 600
"""Samples of a simulated recording; its evidence is scaled to the samples that the real one would have."""

_FAST_S = 5.0
"""Seconds of a fast turn by hand, and for which a pose is held."""

_SLOWER = 8.0
"""Duration of a slow turn over that of a fast one: effects of the rate of turning are then small."""

_LEAST_SAMPLES_PER_TURN = 16
"""Samples in a turn at least: with fewer they no longer resolve the motion."""

_RAMPS = 2
"""Times that the temperature goes down and up: once would look like a drift with time."""

_LEAST_RISE_K = 5.0
"""Least change of temperature, K: that of a box in the sun or a refrigerator."""

_SWITCHINGS = 12
"""Times that the current is switched, each at other attitudes."""

_LEAST_CURRENT_A = 1.0
"""Least change of current, A, where the recording itself has no larger one."""

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
        """Return the covariates that the array of a recording would meet.

        Temperature and current stay as they are, unless they are changed on purpose.

        Parameters
        ----------
        now : Covariates
            Of the recording at hand, from which errors, array, field and levels of the channels are taken.
        channels : collection of str
            Fields of ``Recording`` that are recorded; the others are None.
        count : int
            Number of samples; of poses each has one sample instead.
        """
        from scipy.spatial.transform import Rotation

        # One sample for each pose that is held: the motion between poses cannot be foreseen.
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
            further={
                name: np.interp(phase, np.linspace(0, 1, now.sample_count), values)
                for name, values in now.further.items()
            },
        )

    def _attitude(self, time_s: FloatArray) -> FloatArray:
        from tam_calibration.simulation.attitude import Tumble, Turntable

        generator, whole = np.random.default_rng(0), 60 * self.minutes
        if self.path == "poses":
            poses: FloatArray = Turntable().attitudes(np.arange(whole / self.turn_s), generator)
            return np.asarray(poses[(time_s / self.turn_s).astype(int)])
        along = {
            "onwards": time_s,
            "back and forth": np.minimum(time_s, whole - time_s),
            "swings": 0.2 * time_s
            + 0.5 * self.turn_s * time_s / whole * np.sin(2 * np.pi * time_s / (3 * self.turn_s)),
        }[self.path]
        return Tumble(2 * np.pi / self.turn_s).attitudes(along, generator)


def candidates(now: Covariates, channels: Collection[str]) -> list[Candidate]:
    """Return the recordings to choose from where effects need some channels.

    Parameters
    ----------
    now : Covariates
        Of the recording at hand: its time step and the ranges of its temperature and current.
    channels : collection of str
        Fields of ``Recording`` that the effects need.
    """
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
    """Return the field (3,) of the world, from the attitudes or else as at middle latitudes, tesla."""
    if now.attitude is None:
        direction = np.array([0.0, 0.5, -np.sqrt(0.75)])
    else:
        direction = np.einsum("nij,nj->i", to_world(now), now.field_T)
    return float(np.mean(now.intensity_T)) * direction / np.linalg.norm(direction)


def _level(channel: FloatArray | None, least: float, otherwise: float) -> tuple[float, float]:
    """Return the middle of a channel's range and its width, no less than least."""
    if channel is None:
        return otherwise, least
    low, high = float(channel.min()), float(channel.max())
    return (low + high) / 2, max(high - low, least)


_MOST_SHAPES = 12
"""Shapes of an effect that are tried on a simulated recording."""


@dataclass(frozen=True, eq=False)
class Setting:
    """The recording at hand: model, covariates, and variance of the noise over that of the array."""

    model: Model
    covariates: Covariates
    variance: float

    def channels(self, covariates: Covariates, added_T: FloatArray | float = 0.0) -> WhitenedChannels:
        """Return the channels of a simulated recording without noise.

        Parameters
        ----------
        covariates : Covariates
            Of the N samples of that recording.
        added_T : (N, 3K + 1) array, optional
            Signal of an effect in the rows, tesla.
        """
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
            covariates.further,
        )
        model = self.model
        if covariates.attitude is None or model.world is None:
            return WhitenedChannels.at(recording, model.array, model.errors, model.intensity_T)
        # Beside the world's field no scalar is read: one that is too large is an intensity that is taken for too small.
        too_small = np.zeros_like(rows)
        too_small[:, -1] = covariates.intensity_T - rows[:, -1]
        return WhitenedChannels.at(
            replace(recording, scalar_T=None),
            model.array,
            model.errors,
            model.intensity_T,
            too_small,
            world=model.world.aligned,
        )

    @property
    def minutes(self) -> float:
        """Duration of the recording at hand."""
        return float(np.ptp(self.covariates.time_s)) / 60

    def samples_per_simulated(self, candidate: Candidate, count: int) -> float:
        """Return the number of samples of the real recording for each one simulated.

        Parameters
        ----------
        candidate : Candidate
            Recording of which the duration is known; its time step is that of the recording at hand.
        count : int
            Number of samples that are simulated of it.
        """
        return 60 * candidate.minutes / self.covariates.step_s / count


def expected_evidence(setting: Setting, first: Part, second: Part, candidate: Candidate, is_nested: bool) -> float:
    """Return the evidence expected of a candidate: the smaller of the true hypothesis' evidence in either case.

    Evidence is twice the log-likelihood ratio. Of nested hypotheses only the first, the more general, is taken as true.

    Parameters
    ----------
    setting : Setting
        The recording at hand.
    first, second : Part
        The hypotheses with their shapes and fitted values; of nested ones the first is the more general.
    candidate : Candidate
        Recording to simulate.
    is_nested : bool
        Whether the second hypothesis is a limit of the first.
    """
    covariates = candidate.covariates(setting.covariates, first.channels | second.channels)
    energy = _unexplained(setting, covariates, first, second)
    if not is_nested:
        energy = min(energy, _unexplained(setting, covariates, second, first))
    return energy * setting.samples_per_simulated(candidate, covariates.sample_count) / setting.variance


def _unexplained(setting: Setting, covariates: Covariates, truth: Part, other: Part) -> float:
    """Return the energy of one effect that neither the calibration nor another effect of any shape explains."""
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
    """Return what an effect adds to the rows (N, 3K + 1), tesla.

    Times of events are scaled to the length of the recording.

    Parameters
    ----------
    setting : Setting
        The recording at hand, in which the times of events were found.
    covariates : Covariates
        Of the N samples of a simulated recording.
    truth : Part
        The effect with its shape and values.
    """
    if truth.effect.is_free_in_time:
        before = setting.covariates.time_s
        covariates = replace(covariates, time_s=np.linspace(before[0], before[-1], covariates.sample_count))
    return truth.signal(chosen(truth.effect.terms(covariates, truth.shape), truth.keys), covariates.scalar_row + 1)


def _terms(setting: Setting, effect: LinearEffect, covariates: Covariates, shape: Shape) -> list[Term]:
    has_scalar = setting.model.recording.scalar_T is not None
    return [
        term for term in effect.terms(covariates, shape) if term.sensor != SCALAR or effect.is_of_site or has_scalar
    ]


def visible_part(setting: Setting, effect: LinearEffect, candidate: Candidate, sensors: set[int]) -> float:
    """Return the part of an effect at some sensors that the calibration cannot absorb, the median over its columns.

    Parameters
    ----------
    setting : Setting
        The recording at hand.
    effect : LinearEffect
        An effect that may have caused the gap, and that the recording at hand cannot show.
    candidate : Candidate
        Recording to simulate.
    sensors : set of int
        Indices of the sensors, ``SCALAR`` or ``ALL``.

    Returns
    -------
    float
        Part of the information on a coefficient, 0 to 1; 0 where the candidate cannot show the effect.
    """
    covariates = candidate.covariates(setting.covariates, effect.channels)
    if effect.obstacle(covariates) is not None:
        return 0.0
    channels = setting.channels(covariates)
    shapes = list(effect.shapes(covariates, channels.residuals))
    terms = _terms(setting, effect, covariates, shapes[len(shapes) // 2]) if shapes else []
    own = [term for term in terms if term.sensor in sensors or ALL in sensors | {term.sensor}]
    if not own:
        return 0.0
    projected = Base(channels, [channels.calibration]).project(channels.design(own))
    visible = np.diag(projected.information) / np.maximum(projected.before, np.finfo(float).tiny)
    return float(np.median(np.clip(visible, 0, 1)))
