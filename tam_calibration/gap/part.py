"""An accepted effect of a model: its shape, its terms and their values."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.effects.effect import LinearEffect
from tam_calibration.effects.term import Key, Term, chosen
from tam_calibration.gap.hypothesis import Hypothesis
from tam_calibration.gap.regression import Base, columns_of
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.fitted_effect import Contribution, FittedEffect, Shape
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class Part:
    """An accepted effect: its shape, which of its terms, and their values (P,) in the order of the listing."""

    effect: LinearEffect
    shape: Shape
    keys: tuple[Key, ...]
    values: FloatArray

    @classmethod
    def of(cls, form: Hypothesis) -> "Part":
        """Accept a hypothesis, with values to start from where it has them."""
        return cls(form.effect, form.shape, form.keys, np.zeros(form.width) if form.values is None else form.values)

    @property
    def channels(self) -> set[str]:
        """Names of the recorded channels that its terms follow, or that its effect always needs."""
        own = tuple(Contribution(sensor, axis, name, {}) for sensor, axis, name in self.keys)
        return {*self.effect.channels, *self.effect.needs(FittedEffect(self.effect.name, self.shape, own))}

    @classmethod
    def at(cls, base: Base, form: Hypothesis) -> "Part":
        """Return a form with the coefficients of least squares at a null model."""
        projected = base.project(base.channels.design(form.terms))
        return replace(cls.of(form), values=projected.inverse()[0] @ projected.score)

    def terms(self, channels: WhitenedChannels) -> list[Term]:
        """Return the terms for the covariates of the channels, at all samples."""
        return chosen(self.effect.terms(channels.covariates, self.shape), self.keys)

    def left_out(self, channels: WhitenedChannels) -> list[Term]:
        """Return the terms at other places that were not selected, of the same names."""
        names = {term.name for term in self.terms(channels)}
        everywhere = () if self.effect.is_of_one_sensor else self.effect.terms(channels.covariates, self.shape)
        return [term for term in everywhere if term.name in names and term.key not in self.keys]

    def signal(self, terms: Sequence[Term], row_count: int) -> FloatArray:
        """Return what the effect adds to the rows, (N, row_count), tesla.

        Parameters
        ----------
        terms : sequence of Term
            As of ``terms``, with features at N samples.
        row_count : int
            Number of rows, 3K + 1.
        """
        total = np.zeros((len(terms[0].features), row_count))
        for term, columns in zip(terms, columns_of(terms), strict=True):
            total += term.signal(self.values[columns], row_count)
        return total

    def fitted(self, terms: Sequence[Term], covariance: FloatArray | None = None) -> FittedEffect:
        """Return the effect with its values and their standard errors.

        Parameters
        ----------
        terms : sequence of Term
            As of ``terms``, in the order of the values.
        covariance : (P, P) array, optional
            Of the values, each in the SI unit of its coefficient; zero where it does not matter.
        """
        error = np.sqrt(np.maximum(np.zeros(len(self.values)) if covariance is None else np.diag(covariance), 0))
        contributions = []
        for term, columns in zip(terms, columns_of(terms), strict=True):
            names = [coefficient.name for coefficient in term.coefficients]
            values = dict(zip(names, self.values[columns].tolist(), strict=True))
            errors = dict(zip(names, error[columns].tolist(), strict=True))
            contributions.append(Contribution(term.sensor, term.axis, term.name, values, errors))
        return FittedEffect(self.effect.name, dict(self.shape), tuple(contributions))
