"""Whether data contradict a prior, the smallest change of the sensors that would explain it, and agreement in a fit.

With d the difference of data and prior in the errors, V its covariance, P that of the prior and Σ that of both, what
counts follows from the fit of both, m, alone: V⁻¹ d = P⁻¹ (m - θ₀), and V⁻¹ = P⁻¹ - P⁻¹ Σ P⁻¹. A change E δ of some
errors, δ normal with the covariance D of what may happen to them, explains the difference better than none by the
factor

    exp(½ qᵀ (M + D⁻¹)⁻¹ q) / √det(1 + D M),    q = Eᵀ V⁻¹ d,  M = Eᵀ V⁻¹ E,

the ratio of the evidences: a change that would explain little, or could be anything, is not preferred.

What else may have changed since a prior than what is named, and how much less certain the prior is by that.

A narrow turn shows few directions well. A contradiction along those may come from one bias. It may as well come from
all sensors, which have warmed while no temperature was recorded, from a sensor that was repaired, or from other iron
aboard. Then errors that the turn does not show have changed too. Often the readings leave both possible. The covariance
of the prior therefore grows by that of each such change times its probability (the law of total variance).

``MotionFit`` compares attitude or angular velocity with all else that a fit is made of.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from numpy.linalg import slogdet

from tam_calibration.core.least_squares import ROUNDING, Normal, whitening
from tam_calibration.core.noise import BLOCKS, SlowSums
from tam_calibration.correction.parts import ALL_BIASES, COMMON_SCALE, KINDS, SEVERAL, in_words
from tam_calibration.fit.ellipsoid import without_scale
from tam_calibration.fit.prior import Prior
from tam_calibration.fit.problem import Place, Posterior, Problem
from tam_calibration.model.data_sheet import DAY_S
from tam_calibration.model.sensor_errors import PARAMETER_NAMES, SensorErrors
from tam_calibration.model.units import ERROR_KINDS, FloatArray, from_nanotesla

FAR_RATIO = 1e5
"""Ratio from which each is fitted by itself: a bias of some fifty times the noise, over which lengths begin to bend."""

_NAMES = {kind.name: kind.axes for kind in ERROR_KINDS}


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """What may have changed.

    Parameters
    ----------
    name : str
        For people: "bias of sensor 2".
    parameters : str
        Kind of the errors: one of `KINDS`, or what changes together.
    sensor : int
        Number of the sensor from 1; 0 where it is not one alone.
    directions : (12 K, M) array
        Changes of the errors by its M unknowns.
    components : tuple of str
        Names of the unknowns.
    unit : str
        Of the unknowns, SI.
    """

    name: str
    parameters: str
    sensor: int
    directions: FloatArray
    components: tuple[str, ...] = ()
    unit: str = ""


def changes_of_sensors(errors: SensorErrors) -> tuple[Hypothesis, ...]:
    """Return what may have changed in the sensors of an array.

    One kind of errors of one sensor, as when it is knocked; all errors of a sensor; the biases of all, as when a
    battery is swapped; the scalar magnetometer against all.

    Parameters
    ----------
    errors : SensorErrors
        Of the K sensors.
    """
    count = errors.sensor_count
    every = np.eye(12 * count).reshape(12 * count, count, 12)
    found = []
    for sensor in range(count):
        for place, kind in enumerate(KINDS):
            if kind == "misalignment" and count == 1:
                continue
            unit = {"scale factor": "1", "bias": "T"}.get(kind, "rad")
            directions = every[:, sensor, 3 * place : 3 * place + 3]
            found.append(Hypothesis(in_words(kind, sensor + 1), kind, sensor + 1, directions, _NAMES[kind], unit))
        found.append(Hypothesis(in_words(SEVERAL, sensor + 1), SEVERAL, sensor + 1, every[:, sensor]))
    if count == 1:
        return tuple(found)
    biases = every[:, :, 6:9].reshape(12 * count, -1)
    found.append(Hypothesis(in_words(ALL_BIASES, 0), ALL_BIASES, 0, biases, unit="T"))
    scale = (every[:, :, :3] * errors.scale_factor).sum(axis=(1, 2))[:, None]
    return (*found, Hypothesis(in_words(COMMON_SCALE, 0), COMMON_SCALE, 0, scale, ("",), "1"))


SIGNIFICANT = 1e-4
"""Probability of a difference below which data and prior contradict: one false alarm in ten thousand updates."""


_SIZES_T = from_nanotesla(np.geomspace(10.0, 1e4, 7))
"""Standard deviations of what may happen to a sensor, from a screwdriver at a metre to an amplifier that broke: as a
bias, and as a scale factor or angle times the field."""


MOST_CHANGES = 3
"""Found one after the other: where more moved, the whole array has, which is one of them. Within a recording something
moves as often: a tool is picked up, used and dropped."""

PLAUSIBLE = 0.05
"""Probability from which a change is named in addition to the most probable one, and the prior widened for it too."""


@dataclass(frozen=True, eq=False)
class Change:
    """Errors that may have moved.

    Parameters
    ----------
    hypothesis : Hypothesis
        What may have changed, by M unknowns.
    directions : (12 K, M) array
        E: changes of all errors, in the convention of the prior, by its unknowns.
    variance : (M,) array
        Of what may happen to them: the diagonal of D.
    probability : float
        Among all changes.
    estimate, standard_errors : (M,) array
        What the difference tells of it.
    """

    hypothesis: Hypothesis
    directions: FloatArray
    variance: FloatArray
    probability: float = 0.0
    estimate: FloatArray = field(default_factory=lambda: np.zeros(0))
    standard_errors: FloatArray = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, eq=False)
class Difference:
    """Data against a prior, both summed up in the fit of both.

    Parameters
    ----------
    score : (12 K,) array
        V⁻¹ d.
    information : (12 K, 12 K) array
        V⁻¹.
    chi_square : float
        dᵀ V⁻¹ d over the directions that the data tell.
    freedom : int
        Their number.
    """

    score: FloatArray
    information: FloatArray
    chi_square: float
    freedom: int

    @classmethod
    def of(cls, prior: Prior, posterior: Posterior) -> "Difference":
        """Return the difference of a prior and the estimate from both."""
        comparable, derivative = prior.in_convention(posterior.errors)
        covariance = derivative @ posterior.covariance @ derivative.T
        distance = prior.whitening.T @ (comparable.to_vector() - prior.errors.to_vector()).ravel()
        # Where the prior has unit variance, that of both is 1 / (1 + λ), λ the information of the data.
        left, turns = np.linalg.eigh(prior.whitening.T @ covariance @ prior.whitening)
        left = np.clip(left, np.finfo(float).eps, 1.0)
        gain, along, back = 1 / left - 1, turns.T @ distance, prior.whitening @ turns
        # Information of the data over that of the prior above which a direction counts: in others they cannot
        # contradict.
        is_seen = gain > 0.01
        chi_square = float(np.sum(along[is_seen] ** 2 * (1 + 1 / gain[is_seen])))
        return cls(back @ along, back * (1 - left) @ back.T, chi_square, int(is_seen.sum()))

    @classmethod
    def since(cls, rest: Normal, covariance: FloatArray, size: int) -> "Difference":
        """Return the difference of the samples from a time on and all that is known before it, without its χ².

        Parameters
        ----------
        rest : Normal
            Of these samples over Q unknowns, at the estimate from all samples.
        covariance : (Q, Q) array
            Of that estimate.
        size : int
            Number of errors, which are the first unknowns.
        """
        of_changes = rest.information - rest.information @ covariance @ rest.information
        return cls(rest.score[:size], of_changes[:size, :size], np.nan, 0)

    @property
    def probability(self) -> float:
        """Of a χ² as large by chance."""
        return probability_of(self.chi_square, self.freedom)

    def evidence(self, change: Change) -> float:
        """Return the logarithm of the factor by which a change explains it better than none."""
        score, information, _ = self._along(change)
        gain = float(score @ np.linalg.solve(information, score))
        return (gain - float(slogdet(information)[1])) / 2

    def estimated(self, change: Change) -> Change:
        """Return a change with what the difference tells of it."""
        score, information, _ = self._along(change)
        size, spread = np.sqrt(change.variance), _inverse(information)
        return replace(change, estimate=size * (spread @ score), standard_errors=size * np.sqrt(np.diag(spread)))

    def without(self, change: Change) -> "Difference":
        """Return the difference that is left where a change explains its part."""
        score, information, reached = self._along(change)
        kept = _inverse(information)
        return Difference(
            self.score - reached @ kept @ score,
            self.information - reached @ kept @ reached.T,
            max(self.chi_square - float(score @ kept @ score), 0.0),
            self.freedom,
        )

    def _along(self, change: Change) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return q, 1 + M and V⁻¹ E of a change's unknowns, each over the size that it may have."""
        directions = change.directions * np.sqrt(change.variance)
        reached = self.information @ directions
        return directions.T @ self.score, np.eye(len(change.variance)) + directions.T @ reached, reached


def _inverse(information: FloatArray) -> FloatArray:
    """Return the inverse of a matrix of which no eigenvalue is below one, its diagonal positive whatever rounds."""
    values, vectors = np.linalg.eigh(information)
    return np.asarray(vectors / np.maximum(values, 1.0) @ vectors.T)


def probability_of(chi_square: float, freedom: int) -> float:
    """Return the probability of a χ² as large by chance; 1 where nothing is free."""
    from scipy.special import chdtrc

    return float(chdtrc(freedom, chi_square)) if freedom else 1.0


def changes_that_explain(difference: Difference, candidates: Sequence[Sequence[Change]]) -> list[list[Change]]:
    """Return the changes that remove a contradiction, each with its plausible rivals after it, the strongest first.

    Parameters
    ----------
    difference : Difference
        Of data and prior.
    candidates : sequence of sequence of Change
        What may have changed, each in all sizes, as of ``candidates_of``.
    """
    found: list[list[Change]] = []
    while len(found) < MOST_CHANGES:
        weighed = [
            [(difference.evidence(change) + log_odds(change), change) for change in sizes] for sizes in candidates
        ]
        best = [max(sizes, key=itemgetter(0)) for sizes in weighed]
        evidence, strongest = max(best, key=itemgetter(0))
        # np.log(1e4): logarithm of the evidence of a change from which it contradicts, however little it is of the
        # whole difference: by chance a given one is convincing at most once in ten thousand updates.
        if evidence < (0.0 if difference.probability < SIGNIFICANT else np.log(1e4)):
            break
        found.append([difference.estimated(change) for change in plausible(best)])
        if is_everything(strongest):
            break
        difference = difference.without(strongest)
    return found


def log_odds(change: Change) -> float:
    """Return the logarithm of the probability of a change before any data, over that of one kind of one sensor.

    Unknowns that no sample shows cost no evidence: of what explains as much, the least is chosen.
    """
    # Of all errors of a sensor, and of all biases, over one kind of one sensor; of all errors of all twice as much.
    log_odds = -float(np.log(100.0))
    if is_everything(change):
        return 2 * log_odds
    return log_odds if change.hypothesis.parameters in (SEVERAL, ALL_BIASES) else 0.0


def plausible(weighed: Sequence[tuple[float, Change]]) -> list[Change]:
    """Return the changes that are not improbable by the logarithms of their probabilities, the most probable first."""
    ordered = sorted(weighed, key=itemgetter(0), reverse=True)
    part = np.exp(np.array([evidence for evidence, _ in ordered]) - ordered[0][0])
    part /= part.sum()
    return [
        replace(change, probability=probability)
        for (_, change), probability in zip(ordered, part.tolist(), strict=True)
        if probability >= PLAUSIBLE or change is ordered[0][1]
    ]


def is_everything(change: Change) -> bool:
    """Whether all has changed, so that nothing is left to be found."""
    return (change.hypothesis.parameters, change.hypothesis.sensor) == (SEVERAL, 0)


def estimated_with(change: Change, prior: Prior, posterior: Posterior) -> Change:
    """Return a change with its estimate by a fit with the prior that is widened by it.

    With θ = x + E δ, x that of the prior, δ is given θ of mean D Eᵀ U⁻¹ (θ - θ₀), U = P + E D Eᵀ, and of variance
    (D⁻¹ + Eᵀ P⁻¹ E)⁻¹.
    """
    comparable, derivative = prior.in_convention(posterior.errors)
    distance = (comparable.to_vector() - prior.errors.to_vector()).ravel()
    size = np.sqrt(change.variance)
    white = prior.whitening.T @ change.directions * size
    spread = _inverse(np.eye(len(size)) + white.T @ white)
    taken = spread @ white.T @ prior.whitening.T
    covariance = spread + taken @ derivative @ posterior.covariance @ derivative.T @ taken.T
    return replace(change, estimate=size * (taken @ distance), standard_errors=size * np.sqrt(np.diag(covariance)))


def candidates_of(prior: Prior, sees_scale: bool) -> list[list[Change]]:
    """Return what may have changed since a prior, each in all sizes, the smallest first.

    Parameters
    ----------
    prior : Prior
        Of K sensors.
    sees_scale : bool
        Whether the intensity of the field is known, so that a scale common to all can be found.
    """
    errors, sensors = prior.errors, prior.errors.sensor_count
    _, derivative = prior.in_convention(errors)
    everything = Hypothesis(in_words(SEVERAL, 0), SEVERAL, 0, np.eye(12 * sensors))
    candidates = []
    for hypothesis in (*changes_of_sensors(errors), everything)[: None if sensors > 1 else -1]:
        directions = derivative @ hypothesis.directions
        if not sees_scale and (sensors == 1 or hypothesis.sensor == 0):
            directions = without_scale(errors) @ directions
        # Part of a change that is left of it in the convention of the prior where that holds it: rounding.
        if np.abs(directions).max() < 1e-9 * np.abs(hypothesis.directions).max():
            continue
        is_bias = hypothesis.directions.reshape(-1, 12, hypothesis.directions.shape[1])[:, 6:9].any(axis=(0, 1))
        unit = np.where(is_bias, 1.0, 1 / prior.calibration.intensity_T)
        candidates.append([Change(hypothesis, directions, (size_T * unit) ** 2) for size_T in _SIZES_T])
    return candidates


_UNNOTICED = 0.01
"""Probability that something moved since the prior by more than its rates of change say."""


_TIMES = (3.0, 10.0, 30.0)
"""Changes that are tried: so many times the random walk of a day, so many kelvins, or both."""


_IS_OF_MATRIX = np.array([not name.startswith("bias") for name in PARAMETER_NAMES])
"""Which of the twelve errors of a sensor multiply the field."""


class Unnamed(NamedTuple):
    """A change that is not named, its probability, and what it adds to the covariance (12 K, 12 K) of the prior."""

    name: str
    probability: float
    covariance: FloatArray


def unnamed_changes(
    difference: Difference, prior: Prior, found: Sequence[Sequence[Change]], candidates: Sequence[Sequence[Change]]
) -> list[Unnamed]:
    """Return what may have changed together with, or instead of, the changes that are named.

    Parameters
    ----------
    difference : Difference
        Of data and prior.
    prior : Prior
        As it was given, with its rates.
    found : sequence of sequence of Change
        Changes that explain the difference, each with its rivals after it; empty where there is no contradiction.
    candidates : sequence of sequence of Change
        What may have changed, each in all sizes, as of ``candidates_of``.
    """
    if any(is_everything(change) for change, *_ in found):
        return []
    few, left = 0.0, difference
    for change, *_ in found:
        few += left.evidence(change) + log_odds(change) + np.log(_UNNOTICED)
        left = left.without(change)
    unnamed = [
        _more(left, change, prior) for change, *_ in found if change.hypothesis.parameters in (*KINDS, ALL_BIASES)
    ]
    if not found:
        unnamed.append(small_changes(difference, candidates))
    return unnamed if prior.rates is None else [*unnamed, _faster(difference, prior, few)]


def small_changes(difference: Difference, candidates: Sequence[Sequence[Change]]) -> Unnamed:
    """Return all changes that are too uncertain to be named.

    Each adds the square of its estimate times its probability: a difference that chance makes once in a thousand
    updates is a small change once in ten.

    Parameters
    ----------
    difference, candidates
        As for ``unnamed_changes``, where nothing was found.
    """
    every = [change for sizes in candidates for change in sizes]
    evidence = np.array([difference.evidence(change) + log_odds(change) for change in every])
    weight = _UNNOTICED / len(every) * np.exp(evidence)
    moved = np.array([change.directions @ difference.estimated(change).estimate for change in every])
    part = weight / (1 + weight.sum())
    return Unnamed("a small change", float(part.sum()), moved.T * part @ moved)


def _more(left: Difference, change: Change, prior: Prior) -> Unnamed:
    """Return what often changes together: all errors of a sensor, or soft iron with the biases of all sensors."""
    sensors = prior.errors.sensor_count
    every = np.eye(12 * sensors).reshape(-1, sensors, 12)
    if change.hypothesis.parameters == ALL_BIASES:
        name, directions = "soft iron of the vehicle", every[:, :, _IS_OF_MATRIX].sum(axis=1)
        scaled = _IS_OF_MATRIX[_IS_OF_MATRIX]
    else:
        sensor = change.hypothesis.sensor
        name, directions, scaled = in_words(SEVERAL, sensor), every[:, sensor - 1], _IS_OF_MATRIX
    intensity_T = prior.calibration.intensity_T
    size_T = np.sqrt(np.mean(change.estimate**2)) * (1.0 if "bias" in change.hypothesis.parameters else intensity_T)
    # Sizes that are tried for the other changes, over that of the change that is named.
    variances = np.square(np.outer((1.0, 0.3, 0.1, 0.03), size_T * np.where(scaled, 1 / intensity_T, 1.0)))
    # Logarithm of the odds, before any reading, that more has changed with what is named: as likely as not.
    return _weighed(name, left, prior, directions, variances, 0.0)


def _faster(difference: Difference, prior: Prior, few: float) -> Unnamed:
    """Return that all errors changed faster than stated, instead of few changes with that logarithm of the evidence."""
    assert prior.rates is not None
    sizes = [size for times in _TIMES for size in ((times, 0.0), (0.0, times), (times, times))]
    rates = np.array([prior.rates.variances(walk**2 * DAY_S, warming_K) for walk, warming_K in sizes])
    variances = np.tile(rates, prior.errors.sensor_count)
    every = np.eye(variances.shape[1])
    # float(np.log(0.05)): logarithm of the probability, before any reading, that rates are stated too small.
    return _weighed("all errors, faster than stated", difference, prior, every, variances, float(np.log(0.05)) - few)


def _weighed(
    name: str, difference: Difference, prior: Prior, directions: FloatArray, variances: FloatArray, log_prior: float
) -> Unnamed:
    """Return a change of several possible sizes, weighed by the evidence of each.

    The directions (12 K, M) are those of M unknowns, the variances (S, M) those of S sizes.
    """
    _, derivative = prior.in_convention(prior.errors)
    directions = derivative @ directions
    changes = [Change(Hypothesis(name, SEVERAL, 0, directions), directions, variance) for variance in variances]
    evidence = np.array([difference.evidence(change) for change in changes])
    total = float(np.logaddexp.reduce(evidence))
    probability = float(np.exp(-np.logaddexp(0.0, np.log(len(changes)) - log_prior - total)))
    variance = probability * np.exp(evidence - total) @ variances
    return Unnamed(name, probability, directions * variance @ directions.T)


LEAST_SHARE = 1e-3
"""Part of the information on a direction that both sides have at least where they can contradict."""

TOO_FAR = 2.0
"""Stated noise over that of the residuals, or the reverse, from which the stated one is not used: a factor of two in
standard errors."""

FAR = 4.0
"""Standard deviations of a normal law, once in 16 000, from which a difference is reported."""


@dataclass(frozen=True, eq=False)
class MotionFit:
    """A fit with attitude or angular velocity as data, to be judged.

    Parameters
    ----------
    problem : Problem
        The likelihood.
    place : Place
        Where it settled.
    """

    problem: Problem
    place: Place

    @cached_property
    def own(self) -> Normal:
        """What attitude or angular velocity tells."""
        return self.problem.motion_at(self.place)

    @cached_property
    def everything(self) -> Normal:
        """What is known in all."""
        return self.problem.normal_at(self.place)

    @cached_property
    def basis(self) -> FloatArray:
        """(Q, M) directions of the free unknowns."""
        return self.problem.basis_at(self.place)

    @cached_property
    def white(self) -> FloatArray:
        """(Q, M) directions of the free unknowns on which the information of all is one."""
        inside = self.basis.T @ self.everything.information @ self.basis
        return np.asarray(self.basis @ whitening(inside, ROUNDING))

    @property
    def scatter(self) -> float:
        """Noise that the residuals of attitude or angular velocity show, the channels that the fit took left out."""
        assert self.problem.motion is not None and self.place.motion is not None
        return self.problem.motion.scatter(*self.problem.rows_at(self.place), self.place.motion, self.taken)

    @property
    def taken(self) -> float:
        """Number of channels of attitude or angular velocity that the fit took."""
        return float(np.sum(_shares(self.white, self.own)[0]))

    def difference(self, some: Normal) -> str:
        """Return χ² of the difference that some data make to the estimate, where chance hardly makes as much.

        At the best errors its score is what the others' balances, and has the variance of the parallel sum of both
        informations (Hausman 1978): no fit without it is needed.
        """
        parts, along = _shares(self.white, some)
        compared = (parts > LEAST_SHARE) & (1 - parts > LEAST_SHARE)
        chi_square, freedom = float(np.sum(along[compared] ** 2 / (parts * (1 - parts))[compared])), int(compared.sum())
        if probability_of(chi_square, freedom) >= SIGNIFICANT:
            return ""
        return f"χ² {chi_square:.3g} of {freedom} errors"

    def lasting(self, along: FloatArray | None = None) -> float:
        """Return by how much what the samples tell varies more than by white noise: for how many the errors last.

        Parameters
        ----------
        along : (Q, M) array, optional
            Directions of the unknowns that count; by default all of which the samples tell anything.
        """
        assert self.problem.motion is not None
        count = self.problem.motion.sample_count
        if count < BLOCKS:
            return 1.0
        if along is None:
            shares, directions = np.linalg.eigh(self.white.T @ self.own.information @ self.white)
            along = self.white @ directions[:, shares > ROUNDING]
        spans = [slice(*span) for span in pairwise(np.linspace(0, count, BLOCKS + 1).astype(int))]
        parts = [self.problem.motion_at(self.place, span) for span in spans]
        information = np.array([along.T @ part.information @ along for part in parts])
        white = whitening(information.sum(axis=0), ROUNDING)
        score = np.array([white.T @ along.T @ part.score for part in parts])
        return SlowSums.of(white.T @ information @ white, score).factor


def _shares(white: FloatArray, some: Normal) -> tuple[FloatArray, FloatArray]:
    """Return the part (M,) that some information is of all on each direction, and its score along them."""
    parts, directions = np.linalg.eigh(white.T @ some.information @ white)
    return np.clip(parts, 0, 1), directions.T @ white.T @ some.score
