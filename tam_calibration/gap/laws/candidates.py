"""Laws that are tried on a residual, each with its evidence and what it predicts."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tam_calibration.effects.covariates import lagged
from tam_calibration.gap.laws import patterns
from tam_calibration.gap.laws.decisions import (
    BINS,
    COARSE,
    LAGS,
    LEAST_PERIODS,
    LENGTHS,
    NEAR,
    OWN_BINS,
    RANGES,
    SLOW,
    STEADY,
    TIE,
    VARIANCES,
)
from tam_calibration.gap.laws.evidence import Bins, Fit, Sums, constant, course, of_normal
from tam_calibration.gap.laws.patterns import Pattern
from tam_calibration.gap.laws.whitened import Residual
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class Candidate:
    """A law with its course, its evidence, and how it is fitted.

    Parameters
    ----------
    pattern : Pattern
    course : str
    evidence : float
        Log marginal likelihood over that of no law, less the log of the number of ones tried.
    fit : callable
        Of the pattern to a residual; returns what it adds to the channels (N, C).
    bins : Bins, optional
        Of a course in time or over a reading.
    length : float
        Correlation length of the course.
    steps : tuple of int
        Bins at which steps are.
    """

    pattern: Pattern
    course: str
    evidence: float
    follows: str | None = None
    bins: Bins | None = None
    length: float = 0.0
    variance: float = 1.0
    steps: tuple[int, ...] = ()
    direction: FloatArray | None = None
    begins_on: bool | None = None

    def columns(self, residual: Residual) -> FloatArray:
        """Return the columns (N, C, p) of its coefficients or processes."""
        columns = self.pattern.columns(residual)
        if self.direction is not None:
            columns = (columns @ self.direction)[:, :, None]
        if self.steps and self.bins is not None:
            bin_of = self.bins.spread(np.arange(len(self.bins.place)), residual.count)
            if self.begins_on is not None:
                on = (np.searchsorted(self.steps, bin_of, side="right") + self.begins_on) % 2
                return np.asarray(columns * on[:, None, None])
            columns = np.concatenate([columns * (bin_of >= step)[:, None, None] for step in self.steps], axis=2)
        return columns

    def fitted(self, residual: Residual, with_errors: bool = False) -> Fit:
        """Return the fit to a residual."""
        columns = self.columns(residual)
        if self.bins is None or self.steps:
            return constant(columns, residual.z, residual.nuisance)
        sums = Sums.of(columns, residual.z, residual.nuisance, self.bins)
        return course(sums, self.length, np.array([self.variance]), with_errors)

    def signal(self, residual: Residual, fit: Fit) -> FloatArray:
        """Return what a fit of the law adds to the channels (N, C), at the samples of any residual of the recording."""
        columns = self.columns(residual)
        if self.bins is None or self.steps:
            return np.asarray(columns @ fit.mean[0])
        return np.asarray((columns @ self.bins.spread(fit.mean, residual.count)[:, :, None])[:, :, 0])


def candidates(residual: Residual, positions_m: FloatArray) -> list[Candidate]:
    """Return all laws tried on a residual, the best first."""
    found: list[Candidate] = []
    near = nearest(residual)
    for place in near:
        found += _in_place(residual, place)
    found += [_constant(residual, one, "constant") for one in patterns.everywhere(residual)]
    found += [_constant(residual, one, "motion") for one in patterns.gradients(residual, positions_m)]
    if len(near) > 2:
        found += [_constant(residual, one, "motion") for one in patterns.bent_everywhere(residual)]
    if residual.sensor_count > 1:
        offsets = patterns.offsets_everywhere(residual)
        found += list(_following(residual, offsets))
        found += list(_tones(residual, offsets))
    return sorted(found, key=lambda one: -one.evidence)


def nearest(residual: Residual) -> list[int | str]:
    """Return the places that hold most of the energy: sensors from 1, and the scalar."""
    places: list[int | str] = [*range(1, residual.sensor_count + 1), "scalar"]
    held = np.array([_held(residual, place) for place in places])
    allowed = held >= NEAR * held.max() - 2 * residual.noise * np.sqrt(6 * residual.count)
    chosen = [place for place, ok in zip(places, allowed, strict=True) if ok]
    order = sorted(chosen, key=lambda place: -held[places.index(place)])
    return order[:3]


def _held(residual: Residual, place: int | str) -> float:
    """Return the energy that a free shift of the rows of a place explains in every sample, beyond that of noise."""
    rows = np.array([3 * residual.sensor_count]) if place == "scalar" else patterns.sensor_rows(int(place))
    response = residual.response[:, :, rows]
    information = np.swapaxes(response, 1, 2) @ response
    trace = np.trace(information, axis1=1, axis2=2).mean()
    if trace <= 0:
        return -np.inf
    information = information + 1e-9 * trace * np.eye(len(rows))
    score = (np.swapaxes(response, 1, 2) @ residual.z[:, :, None])[:, :, 0]
    energy = (score * np.linalg.solve(information, score[:, :, None])[:, :, 0]).sum()
    free = np.linalg.matrix_rank(information, tol=1e-6 * trace).sum()
    return float(energy - residual.noise * free)


def _in_place(residual: Residual, place: int | str) -> Iterator[Candidate]:
    """Yield the candidates of one place."""
    if place == "scalar":
        own = list(patterns.in_scalar(residual))
    else:
        own = list(patterns.in_sensor(residual, int(place)))
        for pattern in patterns.own_fields(residual, int(place)):
            yield _constant(residual, pattern, "motion")
        for pattern in patterns.rates_of(residual, int(place)):
            yield _constant(residual, pattern, "constant")
        yield from _over_reading(residual, int(place))
    for pattern in patterns.attitudes(residual, place):
        yield _constant(residual, pattern, "constant" if pattern.law == "rate" else "motion")
    count = max(min(BINS, residual.count // 2), 4)
    bins = Bins.of(residual.time_s, count)
    for pattern in own:
        if pattern.law == "rate":
            yield _constant(residual, pattern, "constant")
        yield from _in_time(residual, pattern, bins)
        yield from _following(residual, pattern)
        if pattern.law == "offset":
            yield from _tones(residual, pattern)


def _constant(residual: Residual, pattern: Pattern, label: str) -> Candidate:
    fit = constant(pattern.columns(residual), residual.z, residual.nuisance)
    return Candidate(pattern, label, fit.evidence, pattern.follows)


def _sizes(residual: Residual) -> FloatArray:
    """Return the variances of processes that are tried: parts of what explains the whole gap."""
    whole = max(residual.excess, 3 * residual.noise * np.sqrt(2.0 * residual.size)) / residual.count
    return np.asarray(np.array(VARIANCES) * whole)


def _in_time(residual: Residual, pattern: Pattern, bins: Bins) -> Iterator[Candidate]:
    """Yield courses in time: steps, slow ones, and fast ones."""
    sums = Sums.of(pattern.columns(residual), residual.z, residual.nuisance, bins)
    coarse, whole = sums.merged(COARSE), float(np.ptp(residual.time_s))
    variances = _sizes(residual)
    best = None
    for length in LENGTHS:
        fit = course(coarse if length >= LENGTHS[1] else sums, length * whole, variances)
        if best is not None and fit.evidence < best - TIE and length < SLOW:
            break
        best = fit.evidence if best is None else max(best, fit.evidence)
        label = "slow" if length >= SLOW else "random"
        yield Candidate(pattern, label, fit.evidence, None, bins, length * whole, fit.variance)
    yield _step(residual, pattern, sums, bins)


def _step(residual: Residual, pattern: Pattern, sums: Sums, bins: Bins) -> Candidate:
    """Return the step that explains most."""
    after = [np.cumsum(one[::-1], axis=0)[::-1] for one in (sums.information, sums.score, sums.cross)]
    evidence, at = _best_split(after, len(sums.place))
    return Candidate(pattern, "step", evidence - np.log(len(sums.place)), None, bins, 0.0, 1.0, (at,))


def _best_split(after: list[FloatArray], bins: int) -> tuple[float, int]:
    information, score, cross = after
    own = information - cross @ np.swapaxes(cross, 1, 2)
    width = own.shape[1]
    trace = np.trace(own, axis1=1, axis2=2)
    allowed = np.arange(bins) > 0
    fixed = own + (1e-6 * trace.max() + 1e-12) * np.eye(width)
    gain = (score * np.linalg.solve(fixed, score[:, :, None])[:, :, 0]).sum(axis=1) * allowed
    at = int(gain.argmax())
    return of_normal(own[at], score[at], np.ones(width)).evidence, at


def _following(residual: Residual, pattern: Pattern) -> Iterator[Candidate]:
    """Yield courses that follow a recorded channel, with and without a lag."""
    duration_s = float(np.ptp(residual.time_s))
    for name, channel in residual.channels.items():
        drives = [lagged(channel, residual.time_s, lag * duration_s) for lag in LAGS]
        drives = [one / one.std() for one in drives if one.std() > 0]
        for drive in drives:
            fit = constant(pattern.times(drive[:, None]).columns(residual), residual.z, residual.nuisance)
            yield Candidate(pattern.times(drive[:, None]), "channel", fit.evidence - np.log(3), name)


def _tones(residual: Residual, pattern: Pattern) -> Iterator[Candidate]:
    """Yield the tone that explains most, steady and wavering."""
    frequency_hz, tried = _line(residual, pattern)
    if frequency_hz is None:
        return
    phase = 2 * np.pi * frequency_hz * (residual.time_s - residual.time_s[0])
    tone = pattern.times(np.column_stack([np.cos(phase), np.sin(phase)]), f"{frequency_hz:.6g} Hz")
    fit = constant(tone.columns(residual), residual.z, residual.nuisance)
    penalty = np.log(tried)
    yield Candidate(tone, "tone", fit.evidence - penalty, tone.follows)
    if len(pattern.rows) <= 3 and fit.evidence > STEADY * residual.excess / 2:
        bins = Bins.of(residual.time_s, COARSE)
        sums = Sums.of(tone.columns(residual), residual.z, residual.nuisance, bins)
        length = 0.25 * float(np.ptp(residual.time_s))
        wavering = course(sums, length, _sizes(residual))
        yield Candidate(tone, "tone", wavering.evidence - penalty, tone.follows, bins, length, wavering.variance)


def _line(residual: Residual, pattern: Pattern) -> tuple[float | None, int]:
    """Return the frequency of most power in the scores of a pattern, and how many were tried."""
    columns = pattern.columns(residual)
    score = np.einsum("ncp,nc->np", columns, residual.z)
    information = np.einsum("ncp,ncq->pq", columns, columns) / residual.count
    values, vectors = np.linalg.eigh(information)
    kept = values > 1e-6 * values[-1]
    score = score @ (vectors[:, kept] / np.sqrt(values[kept]))
    time_s = residual.time_s - residual.time_s[0]
    step_s = float(np.median(np.diff(time_s)))
    slot = np.round(time_s / step_s).astype(int)
    if slot[-1] > 16 * len(slot):
        return None, 1
    length = 4 << int(np.ceil(np.log2(slot[-1] + 1)))
    on_lattice = np.zeros((length, score.shape[1]))
    np.add.at(on_lattice, slot, score)
    power = (np.abs(np.fft.rfft(on_lattice, axis=0)) ** 2).sum(axis=1)
    frequency = np.fft.rfftfreq(length, step_s)
    power[frequency < LEAST_PERIODS / time_s[-1]] = 0
    at = int(power.argmax())
    spacing = frequency[1]
    # Three parabolas through the exact power: the lattice is a quarter of a line's width.
    best, width = frequency[at], spacing / 2
    for _ in range(3):
        around = best + width * np.arange(-1, 2)
        exact = (np.abs(np.exp(-2j * np.pi * np.outer(around, time_s)) @ score) ** 2).sum(axis=1)
        bend = exact[0] - 2 * exact[1] + exact[2]
        best = best + (np.clip(0.5 * (exact[0] - exact[2]) / bend, -1, 1) * width if bend < 0 else 0)
        width /= 4
    return float(best), max(len(frequency) // 4, 1)


def _over_reading(residual: Residual, sensor: int) -> Iterator[Candidate]:
    """Yield any function of an axis' own reading, the same both ways or not."""
    for axis, row in enumerate(patterns.sensor_rows(sensor)):
        reading = residual.sensed[:, row]
        one = np.ones((residual.count, 1, 1))
        pattern = Pattern("own_field", (sensor,), (patterns.AXES[axis],), np.array([row]), one)
        columns = pattern.columns(residual)
        for branch in (None, np.sign(residual.sensed_rate[:, row])):
            bins = Bins.of(reading, min(OWN_BINS, max(residual.count // 4, 4)), branch)
            sums = Sums.of(columns, residual.z, residual.nuisance, bins)
            for part in RANGES:
                length = part * float(np.ptp(reading))
                fit = course(sums, length, _sizes(residual))
                yield Candidate(pattern, "motion", fit.evidence - 1, None, bins, length, fit.variance)
