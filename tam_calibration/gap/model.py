"""A model of a recording: calibration and accepted effects, fitted together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tam_calibration.array import Array
from tam_calibration.effects.effect import Contribution, Finding, FittedEffect, LinearEffect, Shape, Term
from tam_calibration.errors import SensorErrors
from tam_calibration.gap.channels import Channels, Design, calibration_design
from tam_calibration.gap.nominal import start, stepped
from tam_calibration.gap.regression import Base
from tam_calibration.gap.search import Hypothesis
from tam_calibration.gap.selection import columns_of
from tam_calibration.recording import Recording
from tam_calibration.units import FloatArray

_MOST_STEPS = 8
_SETTLED = 1e-3


@dataclass(frozen=True, eq=False)
class Part:
    """An accepted effect: its shape, which of its terms, and their values (P,) in the order of the listing."""

    effect: LinearEffect
    shape: Shape
    keys: tuple[tuple[int, int | None, str], ...]
    values: FloatArray

    @classmethod
    def of(cls, form: Hypothesis) -> "Part":
        """Accept a hypothesis; its values are not known yet."""
        keys = tuple((term.sensor, term.axis, term.name) for term in form.terms)
        return cls(form.effect, form.shape, keys, np.zeros(form.design.width))

    def terms(self, channels: Channels) -> list[Term]:
        """Return the terms in the situation of the channels."""
        found = {
            (term.sensor, term.axis, term.name): term for term in self.effect.terms(channels.situation, self.shape)
        }
        return [found[key] for key in self.keys]

    def signal(self, terms: Sequence[Term], row_count: int) -> FloatArray:
        """Return what the effect adds to the rows, (N, row_count), tesla."""
        total = np.zeros((len(terms[0].features), row_count))
        for term, columns in zip(terms, columns_of(terms), strict=True):
            total += term.signal(self.values[columns], row_count)
        return total

    def fitted(self, terms: Sequence[Term], covariance: FloatArray) -> FittedEffect:
        """Return the effect with its values and their standard errors."""
        error = np.sqrt(np.maximum(np.diag(covariance), 0))
        contributions = []
        for term, columns in zip(terms, columns_of(terms), strict=True):
            names = [coefficient.name for coefficient in term.coefficients]
            values = dict(zip(names, self.values[columns].tolist(), strict=True))
            errors = dict(zip(names, error[columns].tolist(), strict=True))
            contributions.append(Contribution(term.sensor, term.axis, term.name, values, errors))
        return FittedEffect(self.effect.name, dict(self.shape), tuple(contributions))


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
        Where there is no scalar channel.
    parts : tuple of Part
        Accepted effects that add to the rows.
    findings : tuple of Finding
        Accepted effects that were found otherwise.
    """

    recording: Recording
    array: Array
    errors: SensorErrors
    intensity_T: float
    parts: tuple[Part, ...] = ()
    findings: tuple[Finding, ...] = ()

    @classmethod
    def nominal(cls, recording: Recording, array: Array) -> "Model":
        """Fit the calibration alone."""
        noisy, errors, intensity = start(recording, array)
        return cls(recording, noisy, errors, intensity).settled()

    @property
    def is_counted(self) -> NDArray[np.bool_]:
        """(N,) whether no accepted effect gave the sample up."""
        counted = np.ones(self.recording.sample_count, dtype=bool)
        for finding in self.findings:
            if finding.flagged is not None:
                counted &= ~finding.flagged
        return counted

    def channels(self, added_T: FloatArray | None = None) -> Channels:
        """Return the channels at the errors of the fit, what is added to the rows taken off."""
        variances = [finding.variance for finding in self.findings if finding.variance is not None]
        beyond = np.sum(variances, axis=0) if variances else None
        return Channels.at(
            self.recording, self.array, self.errors, self.intensity_T, added_T, self.is_counted, beyond
        )

    def settled(self) -> "Model":
        """Return the model with calibration and effects fitted together, by Gauss-Newton steps."""
        model = self
        added: FloatArray | None = None
        for _ in range(_MOST_STEPS):
            channels = model.channels(added)
            terms = [part.terms(channels) for part in model.parts]
            base = Base(channels, [calibration_design(channels.situation), *map(Design.of, terms)])
            ends = np.cumsum([12 * model.recording.sensor_count, *(len(part.values) for part in model.parts)])
            pieces = np.split(base.step, ends[:-1])
            parts = tuple(
                replace(part, values=part.values + step) for part, step in zip(model.parts, pieces[1:], strict=True)
            )
            fall = channels.energy - base.energy
            errors = stepped(model.errors, pieces[0], float(np.mean(channels.situation.intensity_T)))
            model = replace(model, errors=errors, parts=parts)
            if parts:
                count = channels.situation.scalar_row + 1
                added = np.sum([part.signal(own, count) for part, own in zip(parts, terms, strict=True)], axis=0)
            if fall < _SETTLED * max(1.0, base.energy / channels.count):
                break
        return model

    def signal(self) -> FloatArray:
        """Return what the effects add to the rows, (N, 3K + 1), tesla."""
        count = 3 * self.recording.sensor_count + 1
        total = np.zeros((self.recording.sample_count, count))
        channels = self.channels()
        for part in self.parts:
            total += part.signal(part.terms(channels), count)
        return total

    def base(self) -> Base:
        """Return the fit as the base of further hypotheses, linearised where it stands."""
        channels = self.channels(self.signal() if self.parts else None)
        designs = [Design.of(part.terms(channels)) for part in self.parts]
        return Base(channels, [calibration_design(channels.situation), *designs])

    def accept(self, form: Hypothesis | Finding) -> "Model":
        """Return the model with one more effect, fitted together."""
        if isinstance(form, Finding):
            return replace(self, findings=(*self.findings, form)).settled()
        return replace(self, parts=(*self.parts, Part.of(form))).settled()
