"""A model of a recording: calibration and accepted effects, fitted together."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import tee
from weakref import WeakKeyDictionary

import numpy as np
from numpy.linalg import LinAlgError
from numpy.typing import NDArray

from tam_calibration.core.field_alignment import aligned
from tam_calibration.core.noise import complete_noise, fast_noise
from tam_calibration.correction.calibration import without_rows
from tam_calibration.effects.effect import Finding
from tam_calibration.effects.grades import NEGLIGIBLE, NOTABLE
from tam_calibration.effects.removal import added_to, attitude_known, filled, linear_effect, require_channels
from tam_calibration.fit.recorded_attitude import misread_attitude
from tam_calibration.gap.floor import floor_of
from tam_calibration.gap.hypothesis import Hypothesis, Part
from tam_calibration.gap.nominal import (
    ENOUGH_SAMPLES,
    objection_to,
    open_parameters,
    outlying_samples,
    sensed_intensity,
    starts,
    steady_parts,
    without_calibration,
    without_channels,
)
from tam_calibration.gap.regression import Base
from tam_calibration.gap.regressors import World, oriented, turns, update
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.fitted_effect import FittedEffect
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

_MOST_ROUNDS = 4
"""Times that a fit is taken up again from where it stopped, as each changes where it is linearised."""


_KNOWN: "WeakKeyDictionary[Model, Base]" = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class Model:
    """A recording, what is known of it, and the calibration and effects that explain it.

    Parameters
    ----------
    recording : Recording
        With filled channels.
    array : Array
        With noise.
    errors : SensorErrors
        Of the fit.
    intensity_T : float
        Constant intensity of the field, where there is no scalar channel.
    world : World, optional
        The field of the world, where the attitude determines one sensor better than the intensity alone.
    is_oriented : (N,) array of bool, optional
        Whether the attitude of a sample is known; of the world.
    parts : tuple of Part
        Accepted effects that add to the rows.
    findings : tuple of Finding
        Accepted effects that were found otherwise.
    stride : int
        The fit takes every stride-th sample.
    """

    recording: Recording
    array: KnownNoiseArray
    errors: SensorErrors
    intensity_T: float
    world: World | None = None
    is_oriented: NDArray[np.bool_] | None = None
    parts: tuple[Part, ...] = ()
    findings: tuple[Finding, ...] = ()
    stride: int = 1

    @classmethod
    def nominal(cls, recording: Recording, array: Array) -> "Model":
        """Fit the calibration alone, or without disturbances so large that the fit fails with them.

        Those are a few outliers, a bias that follows a recorded channel, or what changes in a part of the recording.

        Parameters
        ----------
        recording : Recording
            As given, of K sensors; holes in its channels are filled.
        array : Array
            Geometry, bounds of the field, and noise; a noise that is not stated is estimated.

        Raises
        ------
        Refused
            When no calibration within the bounds of sensors fits the readings, or a part of them.
        """
        stride = recording.sample_count // ENOUGH_SAMPLES + 1
        is_oriented, outlying = attitude_known(recording), outlying_samples(recording)
        if outlying.any():
            clean = cls.nominal(recording.take(~outlying), array)
            return replace(clean, recording=filled(recording), is_oriented=is_oriented, stride=stride)
        recording = filled(recording)
        if recording.sensor_count == 1 and recording.scalar_T is None and is_oriented is not None:
            in_world = cls._in_world(recording, array, is_oriented, stride)
            if in_world is None or in_world._is_gross():
                rest = without_channels(recording, is_oriented)
                following = None if rest is None else cls._in_world(rest, array, is_oriented, stride)
                in_world = _most_agreeing(in_world, following)
            if in_world is not None:
                return replace(in_world, recording=recording)
        noisy, _ = complete_noise(array, recording)
        # No fit yet: what all fits from here on share.
        start = cls(recording, noisy, SensorErrors.none(recording.sensor_count), np.nan, stride=stride)
        plain = start._first(_converged)
        if plain is not None:
            plain = plain._with_floor(array)
            if not plain._is_gross():
                return plain
        following = start._following(plain)
        if following is not None:
            return replace(following._with_floor(array), recording=recording)
        return start._of_part(array, plain)

    def aligned(self) -> "Model":
        """Return the model with attitudes in which the field of the sensors is constant in the world.

        An attitude that is noisy, or mounted askew, then does no harm to effects that follow it. That of one sensor in
        the field of the world is aligned already.

        Raises
        ------
        InputError
            When the attitude was written otherwise than expected.
        """
        recording = self.recording
        if recording.attitude is None or self.world is not None:
            return self
        if misread := misread_attitude(recording, self.errors):
            raise InputError(misread)
        attitude = aligned(recording.attitude, self.errors.restore(recording.readings_T).mean(axis=1))
        return replace(self, recording=replace(recording, attitude=attitude))

    def _following(self, plain: "Model | None") -> "Model | None":
        """Return the fit to the readings without biases that follow the channels, if more samples agree with it."""
        rest = without_channels(self.recording)
        following = None if rest is None else self._within_bounds(rest)
        return following if _most_agreeing(plain, following) is following else None

    def _of_part(self, stated: Array, plain: "Model | None") -> "Model":
        """Return the plain fit or, where there is none, that to a part of the recording.

        Raises
        ------
        Refused
            When neither exists, or the calibration that the readings determine is out of the bounds of sensors.
        """
        if plain is None and (part := self._first(_of_better_half) or self._of_steady()) is not None:
            plain = part._with_floor(stated, settled=False)
        begun = next(self._begun(), None)
        # Where the attitudes determine the calibration, and it fits, it may yet be out of the bounds of sensors.
        if plain is None or (
            begun is not None
            and begun.objection is not None
            and not begun._is_gross()
            and open_parameters(self.recording, self.array) is None
        ):
            raise Refused(without_calibration(self.recording, None if begun is None else begun.objection))
        return plain

    @cached_property
    def _starts(self) -> Iterator[tuple[SensorErrors, float]]:
        """The starts of a fit: copies of this iterator share what has been made."""
        return tee(starts(self.recording, self.array), 1)[0]

    def _begun(self) -> Iterator["Model"]:
        """Yield the starts of a fit, each of which is made once."""
        for errors, intensity_T in copy(self._starts):
            yield replace(self, errors=errors, intensity_T=intensity_T)

    def _first(self, fit: "Callable[[Model], Model | None]") -> "Model | None":
        """Return the first fit from all starts that are within the bounds of sensors and of the Earth's field."""
        for model in self._begun():
            if model.objection is None:
                with suppress(InputError, Refused, LinAlgError):
                    if (fitted := fit(model)) is not None:
                        return fitted
        return None

    def _within_bounds(self, recording: Recording) -> "Model | None":
        """Return the first fit, of all starts, that converges within the bounds of sensors and of the Earth's field."""
        return replace(self, recording=recording)._first(_converged)

    def _of_steady(self) -> "Model | None":
        """Return a fit to a steady part of the run and all samples that agree: of the part with the most of them."""
        fits = []
        for part in steady_parts(self.recording):
            with suppress(InputError):
                model = self._within_bounds(self.recording.take(part))
                if model is not None and not model._is_gross():
                    fits.append(replace(model, recording=self.recording))
        best = _most_agreeing(*fits)
        if best is None:
            return None
        agreeing = replace(best, recording=self.recording.take(best.agrees)).settled()
        return replace(agreeing, recording=self.recording)

    def steady(self) -> "Model | None":
        """Return the model with the calibration of a steady part of the run, where the residual of the whole is gross.

        None where it is not, or where no part agrees with more samples.
        """
        if self.world is not None or not self._is_gross():
            return None
        best = _most_agreeing(self, self._first(_of_better_half), self._of_steady())
        return None if best is None or best is self else replace(self, errors=best.errors, intensity_T=best.intensity_T)

    def _with_floor(self, stated: Array, settled: bool = True) -> "Model":
        """Return the model with the noise of the recording, where none is stated or the stated one is contradicted."""
        floor = floor_of(self.channels(), stated)
        noise_T = self.array.vector_noise_T
        if stated.vector_noise_T is not None:
            noise_T = stated.vector_noise_T * floor.factor_common_to_all(int(self.is_counted.sum()))
        elif floor.is_determined:
            noise_T = np.sqrt(np.mean(floor.level_T[:-1].reshape(-1, 3) ** 2, axis=1))
        else:
            base = self.base()
            noise_T = noise_T * np.sqrt(base.energy / max(base.channels.count - base.rank, 1.0))
        if np.array_equal(noise_T, self.array.vector_noise_T):
            return self
        model = replace(self, array=replace(self.array, vector_noise_T=noise_T))
        return model.settled() if settled else model

    @property
    def is_settled(self) -> bool:
        """Whether no step would lower the energy by much: bounds do not hold the fit back."""
        base = self.base()
        return base.fall <= NEGLIGIBLE * base.channels.energy

    @classmethod
    def _in_world(
        cls, recording: Recording, array: Array, is_oriented: NDArray[np.bool_], stride: int
    ) -> "Model | None":
        """Fit one sensor in the field of the world.

        None where the intensity of the field alone determines its bias much better.
        """
        noisy, _ = complete_noise(array, recording)
        try:
            errors, world = oriented(recording.take(is_oriented))
            model = cls(recording, noisy, errors, world.intensity_T, world, is_oriented, stride=stride).settled()
            by_length = replace(model, world=None).base()
        except (InputError, Refused, LinAlgError):
            return None
        base = model.base()
        assert model.world is not None
        # A field disturbance degrades both fits alike; errors of the attitude do not affect that by the intensity.
        # The intensity of the field determines nine parameters of one sensor.
        if by_length.calibration_rank == 9 and bias_variance(by_length) < NOTABLE * bias_variance(base):
            return None
        return replace(model, world=replace(model.world, variance_T2=attitude_variance(base.channels, model.world)))

    def _is_gross(self) -> bool:
        """Whether the residual is no small disturbance of the field."""
        return bool(np.sqrt(np.mean(self._relative_residual**2)) > NEGLIGIBLE)

    @property
    def agrees(self) -> NDArray[np.bool_]:
        """(N,) whether the residual of a sample is a small disturbance of the field."""
        return self._relative_residual <= NEGLIGIBLE

    @property
    def _relative_residual(self) -> FloatArray:
        """(N,) root mean square of the shifts of the rows that explain a sample, in units of the field.

        Rows weigh by their information: one that lies across the field explains noise by a large shift.
        """
        channels = self.channels()
        information = channels.residuals.row_information
        weight = information / np.maximum(information.max(axis=1, keepdims=True), np.finfo(float).tiny)
        square = np.mean(channels.residuals.row_shift_T**2 * weight, axis=1)
        return np.asarray(np.sqrt(square) / np.median(channels.covariates.intensity_T))

    @property
    def is_counted(self) -> NDArray[np.bool_]:
        """(N,) whether no accepted effect excludes the sample."""
        counted = np.ones(self.recording.sample_count, dtype=bool)
        for finding in self.findings:
            if finding.flagged is not None:
                counted &= ~finding.flagged
        if self.world is not None and self.is_oriented is not None:
            counted &= self.is_oriented
        return counted

    @property
    def row_noise_T(self) -> FloatArray:
        """(3K,) standard deviation of the white noise of each row: the array's, and what the attitude adds."""
        variance = np.repeat(self.array.vector_noise_T**2, 3)
        return np.sqrt(variance if self.world is None else variance + self.world.variance_T2)

    def channels(self, added_T: FloatArray | None = None) -> WhitenedChannels:
        """Return the whitened channels at the errors of the fit, after subtracting what is added to the rows."""
        variances = [finding.variance for finding in self.findings if finding.variance is not None]
        beyond = np.sum(variances, axis=0) if variances else None
        spreads = tuple(finding.spread_T for finding in self.findings if finding.spread_T is not None)
        fit = (self.recording, self.array, self.errors, self.intensity_T)
        channels = WhitenedChannels.at(*fit, added_T, self.is_counted, beyond, self.stride, self.world)
        return channels.whitened(spreads)

    def settled(self) -> "Model":
        """Return the model with calibration and effects fitted together, by Gauss-Newton steps that do not climb."""
        model, base = self, self.base()
        # A fit that needs more steps is held back by its bounds or runs away.
        for _ in range(8):
            # A fall of 1e-5 of the energy of one channel is far below any evidence.
            if base.fall < 1e-5 * max(1.0, base.energy / base.channels.count):
                break
            lower = model._lower(base)
            if lower is None:
                break
            model, base = lower
        return model

    def _lower(self, base: Base) -> tuple["Model", Base] | None:
        """Return the model after a step, shortened until it does not climb, with its base; None where none helps."""
        for length in (1.0, 0.5, 0.125, 0.03):
            try:
                model = self._stepped(length * base.step, base)
                moved = model.base()
            except (InputError, Refused, LinAlgError):
                continue
            if moved.energy_with(base.prior_weight) <= base.energy_with(base.prior_weight) and model.objection is None:
                return model, moved
        return None

    @property
    def objection(self) -> str | None:
        """Which bound of sensors or field the calibration exceeds, in one clause, or None."""
        intensity_T = self.intensity_T
        if self.recording.scalar_T is None:
            intensity_T = sensed_intensity(self.errors, intensity_T, self.array.field)
        return objection_to(self.errors, intensity_T, self.array.field)

    def _stepped(self, step: FloatArray, base: Base) -> "Model":
        ends = np.cumsum([design.width for design in base.designs])
        own, *others = np.split(step, ends[:-1])
        parts = tuple(
            replace(part, values=part.values + change) for part, change in zip(self.parts, others, strict=True)
        )
        return replace(self.moved(own, base.channels), parts=parts)

    def moved(self, step: FloatArray, channels: WhitenedChannels) -> "Model":
        """Return the model with its calibration after a step, in the frame of the first sensor.

        Parameters
        ----------
        step : (P,) array
            Of the coefficients of ``channels.calibration``.
        channels : WhitenedChannels
            Of the model before the step.

        Raises
        ------
        InputError
            When a matrix is no longer one of a sensor.
        Refused
            When the step leads to a value that is not finite.
        """
        unit_T = float(np.mean(channels.covariates.intensity_T))
        if self.world is None:
            matrix, bias = update(self.errors, step, unit_T)
            first = SensorErrors.from_matrix(matrix, bias).rotation[0]
            return replace(self, errors=SensorErrors.from_matrix(matrix @ first.T, bias, self.errors.orientation))
        errors, world = self.world.stepped(self.errors, step, unit_T)
        return replace(self, errors=errors, world=world, intensity_T=world.intensity_T)

    def signal(self) -> FloatArray:
        """Return what the effects add to the rows, (N, 3K + 1), tesla."""
        count = 3 * self.recording.sensor_count + 1
        total: FloatArray = np.zeros((self.recording.sample_count, count))
        for _ in range(2 if self.parts else 0):  # the first time in the field that the effects disturb
            channels = self.channels(total)
            total = np.sum([part.signal(part.terms(channels), count) for part in self.parts], axis=0)
        return total

    def without(self, effects: Sequence[FittedEffect]) -> Recording:
        """Return the recording without what fitted effects add to it.

        They follow the field that the sensors agree on or, of one sensor, that of the recorded attitude: a single
        sensor's own readings have its noise, which effects of rates of change multiply.

        Parameters
        ----------
        effects : sequence of FittedEffect
            Linear effects, at most with the sensors of the recording.

        Raises
        ------
        InputError
            When the recording lacks a channel that an effect needs.
        """
        recording = self.recording
        if not effects:
            return recording
        if self.world is None:
            added = added_to(recording, effects, self.errors, self.array)
        else:
            require_channels(recording, effects)
            covariates = self.channels().covariates
            added = np.sum([linear_effect(fitted).signal(covariates, fitted) for fitted in effects], axis=0)
        return without_rows(recording, added, self.errors)

    def quiet(self) -> Recording:
        """Return the recording without what its accepted effects add to it."""
        channels = self.channels()
        return self.without([part.fitted(part.terms(channels)) for part in self.parts])

    def base(self) -> Base:
        """Return the fit as the base of further hypotheses, linearised where it stands; kept of a short recording."""
        if self in _KNOWN:
            return _KNOWN[self]
        channels = self.channels(self.signal() if self.parts else None)
        # A step to a sensor with a scale factor of zero leaves no field.
        if not (np.isfinite(channels.energy) and np.median(channels.covariates.intensity_T) > 0):
            raise Refused("the fit does not settle: the readings do not fit one calibration")
        designs = [channels.design(part.terms(channels)) for part in self.parts]
        base = Base(channels, [channels.calibration, *designs])
        if self.recording.sample_count <= ENOUGH_SAMPLES:
            _KNOWN[self] = base
        return base

    def accept(self, form: Hypothesis | Finding) -> "Model":
        """Return the model with one more effect, fitted together."""
        if isinstance(form, Finding):
            return replace(self, findings=(*self.findings, form)).settled()
        return replace(self, parts=(*self.parts, Part.of(form))).settled()

    def of_all_samples(self) -> "Model":
        """Return the model fitted to every sample."""
        return self if self.stride == 1 else replace(self, stride=1).settled()


def _converged(model: Model) -> Model | None:
    """Return the fit of a model that converges; None where it does not."""
    for _ in range(_MOST_ROUNDS):
        model = model.settled()
        if model.is_settled:
            return model
    return None


def _of_better_half(model: Model) -> Model | None:
    """Return the fit of a model to the half of its samples that it fits best; None where it does not fit these.

    By least trimmed squares: each step fits the half with the least energy under the fit before (Rousseeuw and Van
    Driessen 1999).
    """
    recording = model.recording
    for _ in range(_MOST_ROUNDS):
        energy = model.channels().energy_per_sample
        half = replace(model, recording=recording.take(energy <= np.median(energy))).settled()
        model = replace(half, recording=recording)
    return model if half.is_settled and not half._is_gross() else None


def _most_agreeing(*fits: Model | None) -> Model | None:
    """Return the first of the fits, each to its own recording, with which most samples agree; None where none is."""
    return max((fit for fit in fits if fit is not None), key=lambda fit: fit.agrees.sum(), default=None)


def attitude_variance(channels: WhitenedChannels, world: World) -> FloatArray:
    """Return the variance (3,) that the white noise of the attitude adds to each row of a sensor, T².

    A small rotation changes a field only across its direction. The white noise of the residual across the field of the
    world therefore exceeds that along it by the noise of the attitude; each row has the part of it that lies across.

    Parameters
    ----------
    channels : WhitenedChannels
        Of one sensor in the field of the world; only samples that count are used.
    world : World
        The fitted field: the noise along it is that of the sensor alone, across it that of the attitude as well.
    """
    covariates, counted = channels.covariates, channels.is_counted
    assert covariates.attitude is not None
    residual = channels.residuals.row_shift_T[counted, :-1]
    in_world = np.einsum("nji,nj->ni", turns(covariates.attitude[counted]), residual)
    frame = np.linalg.qr(world.field_T[:, None], mode="complete")[0]
    along, *across = fast_noise(in_world @ frame)
    variance = max(float(np.mean(np.square(across)) - along**2), 0.0)
    part_across: FloatArray = 1 - np.mean(channels.direction[counted, :3] ** 2, axis=0)
    return variance * part_across


def bias_variance(base: Base) -> float:
    """Return the summed variance of a sensor's three offsets, scaled by the residual, over the squared intensity.

    Directions that the recording does not determine count as zero: compare fits of equal rank only.
    """
    # The offset is the last of the four columns of each axis.
    variance = np.diag(base.inverse)[3:12:4]
    return float(variance.sum()) * base.energy / max(base.channels.count - base.rank, 1.0)
