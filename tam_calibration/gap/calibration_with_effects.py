"""A calibration with effects: the errors of the sensors and what the effects add, fitted together and kept together.

Their uncertainty is that of both together, from the residual as it is.
"""

from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tam_calibration.correction.acceptance import within_limits
from tam_calibration.correction.calibration import Calibration, EffectSize
from tam_calibration.effects.library import effect_named, installed_effects, shown_by
from tam_calibration.effects.removal import linear_effect, on_sensors
from tam_calibration.effects.term import Coefficient, Term, at_rows
from tam_calibration.fit import calibrate
from tam_calibration.fit.estimate import Estimate, make_calibration
from tam_calibration.fit.identifiability import refuse_open, require_determined
from tam_calibration.fit.scale import free_scale
from tam_calibration.gap.coloured import covariance_of
from tam_calibration.gap.conclude import conclude
from tam_calibration.gap.hypothesis import Hypothesis, refined
from tam_calibration.gap.model import Model
from tam_calibration.gap.nominal import stepped
from tam_calibration.gap.part import Part
from tam_calibration.gap.regression import Base, columns_of, pseudo_inverse
from tam_calibration.gap.regressors import Regressors
from tam_calibration.gap.result import Gap
from tam_calibration.gap.search import search
from tam_calibration.gap.search_result import Search
from tam_calibration.gap.size import Evidence, examine, unusable
from tam_calibration.gap.steps import LEAST_EVIDENCE
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.integrity import CHANNEL_FAULTS, require_sound
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.fitted_effect import ALL, FittedEffect, Shape
from tam_calibration.model.recording import Recording
from tam_calibration.model.residuals import measure_residuals
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

_STEP = 0.01
"""Step of a parameter of the shape for numerical derivatives, as a part of its value."""

_ROUNDING = 1e-9
"""Part of what an effect adds below which a step of its shape changes nothing: rounding is 1e-15 of it, and a step that
tells anything of a parameter changes more than 1e-6."""

_FIRST_TURN = slice(9, 12)
"""Misalignment of the first sensor, which is zero."""

_SAMPLES = 2000
"""Samples, spread over the recording, over which the uncertainty of an effect's signal is averaged."""


@dataclass(frozen=True, eq=False)
class Joint:
    """The parameters of calibration and effects at the end of their fit.

    Parameters
    ----------
    model : Model
        With the array, the errors and the intensity of the calibration.
    free : tuple of tuple of str
        Parameters of the shape of each effect that were fitted.
    """

    model: Model
    free: tuple[tuple[str, ...], ...]

    @cached_property
    def effects(self) -> tuple[FittedEffect, ...]:
        """The effects with values and standard errors."""
        effects, start = [], 0
        for part, terms, names in zip(self.model.parts, self._terms, self.free, strict=True):
            end = start + len(part.values)
            fitted = part.fitted(terms, self._covariance[start:end, start:end])
            variance = np.diag(self._covariance)[end : end + len(names)]
            known = {name: float(np.sqrt(value)) for name, value in zip(names, variance, strict=True) if value > 0}
            effects.append(replace(fitted, shape_errors=known))
            start = end + len(names)
        return tuple(effects)

    def shared_covariance(self, errors: SensorErrors, has_scalar: bool) -> FloatArray:
        """Return what the effects' uncertainty adds to the covariance (12 K, 12 K) of errors in the first's frame.

        Parameters
        ----------
        errors : SensorErrors
            Of K sensors, in the frame of the first.
        has_scalar : bool
            Whether a scalar reference determines the common scale; else the geometric mean of the determinants is 1.
        """
        if not self.model.parts:
            return np.zeros((errors.to_vector().size,) * 2)
        shift = pseudo_inverse(self._nominal.information) @ self._channels.cross(self._nominal.designs[0], self._design)
        return self._of_errors(errors, has_scalar, -shift, self._covariance)

    def covariance_in_world(self) -> FloatArray:
        """Return the covariance (12 K, 12 K) of the errors in the field of the world, the effects taken as known.

        It is scaled by the residual, as nobody states the noise of an attitude.
        """
        base = self.model.base()
        factor = base.energy / max(base.channels.count - base.rank, 1.0)
        own = self._nominal.inverse
        return self._of_errors(self.model.errors, False, np.eye(len(own)), factor * own)

    def _of_errors(
        self, errors: SensorErrors, has_scalar: bool, shift: FloatArray, covariance: FloatArray
    ) -> FloatArray:
        """Return the covariance of the errors from that of P coefficients, whose units shift the design of them."""
        deviation = np.sqrt(np.maximum(np.diag(covariance), 0))
        columns = [
            (self._moved(errors, has_scalar, step) - self._moved(errors, has_scalar, -step)) / 2
            for step in (shift * deviation).T
        ]
        slope = np.column_stack(columns)
        slope[_FIRST_TURN] = 0
        correlation = covariance / np.outer(*[np.where(deviation > 0, deviation, 1)] * 2)
        return slope @ correlation @ slope.T

    def _moved(self, errors: SensorErrors, has_scalar: bool, step: FloatArray) -> FloatArray:
        """Return the flattened parameters of errors after a step of their design."""
        unit = float(np.mean(self._channels.covariates.intensity_T))
        if self.model.world is not None:
            return self.model.world.stepped(errors, step, unit)[0].to_vector().ravel()
        moved = stepped(errors, step, unit)
        if not has_scalar:
            moved = SensorErrors.from_matrix(free_scale(moved.matrix) * moved.matrix, moved.bias_T, errors.orientation)
        return moved.to_vector().ravel()

    def sizes(self, calibration: Calibration) -> tuple[EffectSize, ...]:
        """Return the size of each effect in the outputs of a calibration, and its standard error."""
        unmix = calibration.correction_matrix
        some = slice(None, None, -(-self.model.recording.sample_count // _SAMPLES))
        sizes, start = [], 0
        for part, terms, all_terms, fitted in zip(
            self.model.parts, self._terms, self._all_terms, self.effects, strict=True
        ):
            own = slice(start, start + sum(len(term.coefficients) for term in all_terms))
            start = own.stop
            if on_sensors(fitted) is None:
                sizes.append(EffectSize(np.zeros(9), np.zeros(9)))
                continue
            added = part.signal(terms, unmix.shape[1] + 1)[:, :-1] @ unmix.T
            sizes.append(
                EffectSize(
                    np.sqrt(np.mean(added**2, axis=0)), _deviation(all_terms, unmix, self._covariance[own, own], some)
                )
            )
        return tuple(sizes)

    @cached_property
    def _channels(self) -> WhitenedChannels:
        return self.model.base().channels

    @cached_property
    def _nominal(self) -> Base:
        return Base(self._channels, [self._channels.calibration])

    @cached_property
    def _terms(self) -> list[list[Term]]:
        return [part.terms(self._channels) for part in self.model.parts]

    @cached_property
    def _all_terms(self) -> list[list[Term]]:
        """For each effect its terms, then one term for each free parameter of its shape."""
        return [
            [*terms, *(_moved(part, name, self._channels) for name in names)]
            for part, terms, names in zip(self.model.parts, self._terms, self.free, strict=True)
        ]

    @cached_property
    def _design(self) -> Regressors:
        return self._channels.design([term for terms in self._all_terms for term in terms])

    @cached_property
    def _covariance(self) -> FloatArray:
        """Covariance of all coefficients and free shape parameters, the calibration marginalised."""
        left_out = [term for part in self.model.parts for term in part.left_out(self._channels)]
        return covariance_of(self._nominal, [self._design], left_out)


def _moved(part: Part, name: str, channels: WhitenedChannels) -> Term:
    """Return the derivative of what an effect adds by one parameter of its shape, as a term."""
    size = _STEP * part.shape[name] or _STEP
    count = channels.covariates.scalar_row + 1

    def added(value: float) -> FloatArray:
        shape: Shape = {**part.shape, name: value}
        moved = replace(part, shape=shape)
        return moved.signal(moved.terms(channels), count)

    above, below = added(part.shape[name] + size), added(part.shape[name] - size)
    change = above - below
    # At two layers that are alike the share of either makes no difference, but for rounding.
    slope = change / (2 * size) if np.abs(change).max() > _ROUNDING * np.abs(above).max() else np.zeros_like(change)
    rows = np.flatnonzero(slope.any(axis=0))
    parameter = Coefficient(name, part.effect.shape_units[name])
    return Term(ALL, None, name, (parameter,), slope[:, rows], rows, np.zeros(len(rows), dtype=np.intp))


def _deviation(terms: Sequence[Term], unmix: FloatArray, covariance: FloatArray, some: slice) -> FloatArray:
    """Return the root mean square (9,) of the standard deviation of what terms add to the outputs."""
    by_column = np.zeros((len(terms[0].features[some]), 9, len(covariance)))
    for term, columns in zip(terms, columns_of(terms), strict=True):
        on_outputs = at_rows(np.vstack([unmix.T, np.zeros(len(unmix))]), term.rows)
        for atom in np.flatnonzero(on_outputs.any(axis=1)):
            by_column[:, :, columns[term.columns[atom]]] += term.features[some, atom, None] * on_outputs[atom]
    variance = np.einsum("nop,pq,noq->o", by_column, covariance, by_column, optimize=True) / len(by_column)
    return np.asarray(np.sqrt(variance))


IN_WORLD = "recorded_attitude"
"""Method of a calibration of one sensor in the field of the world."""

_AUTO = "auto"
"""Given instead of names: the effects that a diagnosis finds."""


def calibrate_with_effects(
    recording: Recording,
    array: Array,
    effects: Collection[str],
    *,
    accept: Collection[str] = (),
) -> Calibration:
    """Fit the errors of an array's sensors together with effects, by maximum likelihood.

    Parameters
    ----------
    recording : Recording
        Samples in a uniform field, with the channels that the effects need.
    array : Array
        Geometry and noise.
    effects : collection of str
        Names of effects, or ``_AUTO`` alone for those that a diagnosis finds.
    accept : collection of str
        Names of findings that shall refuse nothing: ``tam_calibration.integrity.ACCEPTABLE``.

    Returns
    -------
    Calibration
        With the effects. Its covariance includes their uncertainty. Residuals are those of readings without what the
        effects add; for held-out samples too the effects are those fitted to the whole recording.

    Raises
    ------
    InputError
        When the recording cannot be used, an effect is not known or lacks a channel.
    Refused
        When the recording cannot show an effect, or shows none of it, or its channels are not those of sound sensors.
    """
    for name in set(effects) - {_AUTO}:
        effect_named(name)
    if _AUTO in effects and len(effects) > 1:
        raise InputError(f"{_AUTO} stands for all effects that are found: name no others beside it")
    array.require_recording(recording)
    faults = require_sound(
        recording, array, accept, sought=shown_by(installed_effects() if _AUTO in effects else effects)
    )
    told = [fault.sentence for fault in faults if fault.severity != "note"]
    recording.check_plausible(array.field)
    if recording.sensor_count > 1 or recording.attitude is None:  # else the attitude may determine what these do not
        with suppress(Refused):  # where readings contradict each other, effects may explain it
            require_determined(recording, array)
    if _AUTO in effects:
        found = search(recording, array)
        return calibration_of(recording, found, conclude(found), array, warnings=told, accept=accept)
    model, warnings = _with_named(Model.nominal(recording, array), effects)
    return _kept(model, array, (*told, *warnings), accept)


def calibration_of(
    recording: Recording,
    found: Search,
    gap: Gap,
    array: Array,
    *,
    warnings: Sequence[str] = (),
    accept: Collection[str] = (),
) -> Calibration:
    """Return the calibration with the effects that a diagnosis found.

    Parameters
    ----------
    recording : Recording
        That was searched.
    found : Search
        Causes, and the models without and with them.
    gap : Gap
        What was concluded of them.
    array : Array
        As it was given.
    warnings : sequence of str
        What the calibration warns of besides.
    accept : collection of str
        Names of findings that shall refuse nothing.

    Raises
    ------
    InputError, Refused
        When the samples determine no calibration, or one that no sensor has.
    """
    model = found.nominal if gap.verdict == "no_gap" else found.model
    left = (gap.statement,) if gap.verdict in ("partly_explained", "unexplained") else ()
    if model.parts or model.findings or model.world is not None:
        return _kept(model, array, (*warnings, *left), accept)
    calibration = calibrate(recording, array, accept=accept)
    return replace(calibration, warnings=(*calibration.warnings, *left))


def _with_named(model: Model, names: Collection[str]) -> tuple[Model, tuple[str, ...]]:
    """Return the model with the named effects accepted, the strongest first, and warnings of those without evidence."""
    waiting, warnings = {name: effect_named(name) for name in names}, []
    for effect in waiting.values():
        reason = unusable(effect, model.recording, model.channels().covariates)
        if reason is None:
            continue
        if reason.status == "channel_missing":
            raise InputError(f"{effect.name} cannot be fitted: it {reason.why}")
        raise Refused(f"{effect.name} cannot be told from this recording: {reason.why}; {effect.excitation}")
    while waiting:
        base = model.base()
        examined = {name: examine(base, effect) for name, effect in waiting.items()}
        visible = [one for one in examined.values() if isinstance(one, Evidence)]
        if not visible:
            name, why = next((name, why) for name, why in examined.items() if isinstance(why, str))
            raise Refused(f"{name} is not in this recording: {why}; calibrate without it")
        best = max(visible, key=lambda one: one.delta_bic)
        if best.delta_bic < LEAST_EVIDENCE:
            warnings.append(f"noise alone explains the recording as well as {best.effect}: leave this effect out")
        form = refined(base, best.form) if isinstance(best.form, Hypothesis) else best.form
        model = model.accept(form)
        del waiting[best.effect]
    return model, tuple(warnings)


def _kept(model: Model, array: Array, warnings: tuple[str, ...], accept: Collection[str]) -> Calibration:
    """Return the calibration of the readings without the effects, with the effects and the uncertainty of both."""
    recording, findings = model.recording, tuple(finding.fitted for finding in model.findings)
    if model.world is None:
        calibration = calibrate(_without(model), array, accept={*CHANNEL_FAULTS, *accept})
        model = replace(model, array=calibration.array, errors=calibration.errors, intensity_T=calibration.intensity_T)
    else:
        calibration = _in_world(model, array, accept)
    joint = Joint(model, tuple(_free(part, model) for part in model.parts))
    assert calibration.covariance is not None
    shared = joint.shared_covariance(calibration.errors, calibration.has_scalar_reference)
    kept = [pair for pair in zip(joint.effects, joint.sizes(calibration), strict=True) if _is_kept(pair[0], model)]
    effects = *(fitted for fitted, _ in kept), *findings
    left = [fitted for fitted in joint.effects if not _is_kept(fitted, model)]
    none = SensorErrors.none(recording.sensor_count)
    return replace(
        calibration,
        covariance=calibration.covariance + shared,
        before=measure_residuals(none, array, recording, calibration.intensity_T),
        samples=recording.sample_count,
        time_span_s=(float(recording.time_s[0]), float(recording.time_s[-1])),
        warnings=tuple(
            dict.fromkeys((*calibration.warnings, *warnings, *_not_corrected(effects), *_of_attitude(left)))
        ),
        effects=effects,
        effect_sizes=(*(size for _, size in kept), *(EffectSize(np.zeros(9), np.zeros(9)) for _ in findings)),
    )


def _is_kept(fitted: FittedEffect, model: Model) -> bool:
    """Whether an effect can be taken off other data: of one sensor not by how its own, noisy readings go on."""
    return model.world is None or linear_effect(fitted).is_causal


def _in_world(model: Model, array: Array, accept: Collection[str]) -> Calibration:
    """Return the calibration of one sensor as its attitude determines it, which its intensity alone may not."""
    errors = replace(model.errors, misalignment=np.zeros((1, 3)))  # the frame is the sensor's own, but for rounding
    covariance = Joint(model, ((),) * len(model.parts)).covariance_in_world()
    estimate = Estimate(errors, covariance, covariance_from_noise=False, intensity_T=model.intensity_T)
    calibration = make_calibration(IN_WORLD, _without(model), array, estimate)
    refuse_open(calibration.standard_errors.ravel(), calibration.intensity_T)
    return within_limits(calibration, accept)


def _without(model: Model) -> Recording:
    """Return the samples of a model's recording that count, without what its effects add."""
    return model.quiet().take(np.flatnonzero(model.is_counted))


def _free(part: Part, model: Model) -> tuple[str, ...]:
    """Return the parameters of a shape that were fitted: those that vary among the shapes tried."""
    channels = model.channels()
    tried = list(part.effect.shapes(channels.covariates, channels.residuals))
    return tuple(name for name in part.shape if len({shape[name] for shape in tried if name in shape}) > 1)


def _of_attitude(effects: Sequence[FittedEffect]) -> tuple[str, ...]:
    """Return a warning of the effects that only the attitude tells how to take off."""
    if not effects:
        return ()
    names = " and ".join(dict.fromkeys(fitted.effect.replace("_", " ") for fitted in effects))
    return (f"{names}: known beside the attitude, and left in corrected data, where it takes less off than noise adds",)


def _not_corrected(effects: Sequence[FittedEffect]) -> tuple[str, ...]:
    """Return a warning of the effects that are known but cannot be removed from corrected data."""
    stay = [fitted.effect.replace("_", " ") for fitted in effects if on_sensors(fitted) is None]
    if not stay:
        return ()
    return (f"{' and '.join(dict.fromkeys(stay))}: kept for simulations, and not taken off corrected data",)
