"""What a hypothesis gains by averaging the noise of the readings, from which it knows the field.

An effect that follows the field's changes takes the field from the same noisy readings that it explains. With large
coefficients it may average neighbouring samples and so make the residual smaller though there is no such effect. Under
the hypothesis the residual is e - F e, with e the noise and F the effect's answer to it: the part of the energy that
it would lose in noise alone is no evidence (errors in variables; Fuller, Measurement Error Models, Wiley, 1987).
"""

from dataclasses import replace
from math import log

import numpy as np

from tam_calibration.gap.regression import Base
from tam_calibration.gap.search import Hypothesis
from tam_calibration.gap.selection import columns_of
from tam_calibration.units import FloatArray

_AT_ENDS = 12
"""Samples at each end of a stretch where rates of change are extrapolated: their noise is no measure of the others'."""


def noise_gain(base: Base, form: Hypothesis) -> float:
    """Return twice the logarithm of the likelihood ratio that a form gains in simulated noise, at its coefficients."""
    channels = base.channels
    situation = channels.situation
    noise_T = situation.array.vector_noise_T
    assert noise_T is not None
    generator = np.random.default_rng(0)
    rows = np.zeros((situation.sample_count, situation.scalar_row + 1))
    rows[:, :-1] = generator.normal(size=(len(rows), situation.scalar_row)) * np.repeat(noise_T, 3)
    rows[:, -1] = generator.normal(size=len(rows)) * (situation.array.scalar_noise_T or 0.0)
    noisy = replace(situation, field_T=situation.field_T - rows[:, :-1] @ channels.turn[:3, :-1].T)
    projected = base.project(channels.design(form.terms))
    values = projected.inverse()[0] @ projected.score
    # Of a long recording a form holds the samples that are fitted only.
    answer = _signal(form.moved(noisy), values, rows.shape[1]) - _signal(form.moved(situation), values, rows.shape[1])
    part = _energy(base, rows - answer) / max(_energy(base, rows), np.finfo(float).tiny)
    return -channels.count * log(part) if 0 < part < 1 else 0.0


def _signal(form: Hypothesis, values: FloatArray, row_count: int) -> FloatArray:
    """Return what a form adds to the rows, (N, row_count), tesla."""
    parts = zip(form.terms, columns_of(form.terms), strict=True)
    return np.asarray(sum(term.signal(values[columns], row_count) for term, columns in parts))


def _energy(base: Base, rows: FloatArray) -> float:
    """Return the energy of shifts of the rows in the channels that count."""
    channels = base.channels
    common = np.sum(channels.row_direction * rows, axis=1) ** 2 * channels.precision
    energy = np.sum((rows[:, :-1] @ channels.directions) ** 2, axis=1) + common
    energy[~channels.is_counted] = 0
    return sum(float(energy[stretch][_AT_ENDS:-_AT_ENDS].sum()) for stretch in channels.situation.stretches)
