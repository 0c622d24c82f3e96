"""Laws that are tried on a residual, each with its evidence and what it predicts."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from tam_calibration.effects.grades import MINOR, MOST
from tam_calibration.effects.recursions import lagged
from tam_calibration.gap.laws import patterns
from tam_calibration.gap.laws.decisions import COARSE, LENGTHS, SLOW, TIE
from tam_calibration.gap.laws.evidence import Bins, course
from tam_calibration.gap.laws.patterns import Candidate, Pattern
from tam_calibration.gap.laws.states import steps
from tam_calibration.gap.laws.whitened import Residual
from tam_calibration.model.units import FloatArray


def candidates(residual: Residual, has_free: bool = True) -> list[Candidate]:
    """Return all laws tried on a residual, the best first.

    Parameters
    ----------
    residual : Residual
    has_free : bool
        Whether with free functions of time and of the own reading; of those in time steps are always tried.
    """
    found: list[Candidate] = []
    near, bins = nearest(residual), Bins.of_time(residual.time_s)
    for place in near:
        found += _in_place(residual, place, bins, has_free)
    found += [next(_steady(residual, one)) for one in patterns.everywhere(residual)]
    for gradient in islice(patterns.gradients(residual), 1):
        found += list(_in_time(residual, replace(gradient, follows=None), bins, LENGTHS if has_free else ()))
    if len(near) > 2:
        found += [next(_steady(residual, one)) for one in patterns.bent_everywhere(residual)]
    if residual.sensor_count > 1:
        offsets = patterns.offsets_everywhere(residual)
        found += list(_following(residual, offsets))
        found += list(_tones(residual, [offsets]))
    return sorted(found, key=lambda one: -one.evidence)


def nearest(residual: Residual) -> list[int | str]:
    """Return the places that hold most of the energy: sensors from 1, and the scalar."""
    places: list[int | str] = [*range(1, residual.sensor_count + 1), "scalar"]
    energies = {place: held(residual, place) for place in places}
    least = 0.6 * max(energies.values()) - 2 * residual.noise * float(np.sqrt(6 * residual.count))
    return sorted((place for place in places if energies[place] >= least), key=lambda place: -energies[place])[:3]


def held(residual: Residual, place: int | str) -> float:
    """Return the energy that a free shift of the rows of a place explains in every sample, beyond that of noise."""
    rows = np.array([3 * residual.sensor_count]) if place == "scalar" else patterns.sensor_rows(int(place))
    of_rows = residual.of_rows(rows)
    trace = np.trace(of_rows.information, axis1=1, axis2=2).mean()
    if trace <= 0:
        return -np.inf
    regular = of_rows.information + 1e-6 * trace * np.eye(len(rows))
    solved = np.linalg.solve(regular, np.concatenate([of_rows.score, of_rows.information], axis=2))
    free = np.trace(solved[:, :, 1:], axis1=1, axis2=2).sum()
    return float((of_rows.score * solved[:, :, :1]).sum() - residual.noise * free)


def _in_place(residual: Residual, place: int | str, bins: Bins, has_free: bool) -> Iterator[Candidate]:
    """Yield the candidates of one place."""
    if place == "scalar":
        own = list(patterns.in_scalar(residual))
    else:
        own = list(patterns.in_sensor(residual, int(place)))
        if has_free:
            yield from _over_reading(residual, int(place))
    for pattern in patterns.of_motion(residual, place):
        yield from _steady(residual, pattern)
    for pattern in own:
        if pattern.law == "rate":
            yield from _steady(residual, pattern)
        yield from _in_time(residual, pattern, bins, LENGTHS if has_free else ())
        yield from _following(residual, pattern)
        if pattern.law == "offset":
            yield from (tone for part, _ in pattern.parts() for tone in _tones(residual, [part]))
    yield from _tones(residual, [part for one in own if one.law in ("gain", "attitude") for part, _ in one.parts()])


def _steady(residual: Residual, pattern: Pattern) -> Iterator[Candidate]:
    """Yield the candidates that go with the motion alone; a law of a rate is constant where its size is."""
    return _constant(residual, pattern, "constant" if pattern.law == "rate" and not pattern.follows else "motion")


def _constant(residual: Residual, pattern: Pattern, label: str, tried: float = 1.0) -> Iterator[Candidate]:
    """Yield the candidates of a pattern and its parts with constant coefficients, the best of so many tried."""
    normal = pattern.normal(residual)
    for part, columns in pattern.parts():
        yield Candidate(part, label, normal.part(columns).fit().evidence - float(np.log(tried)))


def _sizes(residual: Residual) -> FloatArray:
    """Return the variances of processes that are tried: parts of what explains the whole gap."""
    whole = max(residual.excess, 3 * residual.noise * np.sqrt(2.0 * residual.size)) / residual.count
    return np.asarray(np.array([0.1, 1.0, 5.0]) * whole)


def _in_time(residual: Residual, pattern: Pattern, bins: Bins, lengths: Sequence[float]) -> Iterator[Candidate]:
    """Yield courses in time of a pattern and its parts: steps, and free ones of some correlation lengths."""
    every, size = pattern.sums(residual, bins), pattern.size(residual)
    whole, variances = float(np.ptp(residual.time_s)), _sizes(residual)
    for part, columns in pattern.parts():
        sums = every if part is pattern else every.part(columns, size / part.size(residual))
        coarse, best = sums.merged(COARSE), -np.inf
        for length in lengths:
            fit = course(coarse if length >= LENGTHS[1] else sums, length * whole, variances)
            if fit.evidence < best - TIE and length < SLOW:
                break
            best = max(best, fit.evidence)
            label = "slow" if length >= SLOW else "random"
            yield Candidate(part, label, fit.evidence, bins, length * whole, fit.variance)
        yield next(steps(part, sums, bins))


def _following(residual: Residual, pattern: Pattern) -> Iterator[Candidate]:
    """Yield courses that follow a recorded channel, at the lag that explains most."""
    duration_s = float(np.ptp(residual.time_s))
    for name, channel in residual.channels.items():
        drives = [lagged(channel, residual.time_s, lag * duration_s) for lag in (0.0, 0.02, 0.1)]
        lagging = [pattern.times(one[:, None] / one.std(), name) for one in drives if one.std() > 0]
        tried = [list(_constant(residual, one, "channel", len(drives))) for one in lagging]
        yield from max(tried, key=lambda one: max(part.evidence for part in one), default=())


def _tones(residual: Residual, similar: Sequence[Pattern]) -> Iterator[Candidate]:
    """Yield the tone of most power in the first of some patterns, with each pattern, steady and wavering."""
    frequency_hz, tried = _line(residual, similar[0])
    if frequency_hz is None:
        return
    phase = 2 * np.pi * frequency_hz * (residual.time_s - residual.time_s[0])
    waves = np.column_stack([np.cos(phase), np.sin(phase)])
    penalty = np.log(tried)
    for pattern in similar:
        tone = pattern.times(waves, f"{frequency_hz:.6g} Hz")
        steady = next(_constant(residual, tone, "tone", tried))
        yield steady
        # A rotor's pace wanders: only a part of its tone is steady. A slower tone would imitate the motion.
        wanders = pattern.law == "offset" and frequency_hz > _pace_hz(residual)
        least = MINOR if wanders else MOST
        if pattern.width > 3 or steady.evidence + penalty < least * residual.excess / 2:
            continue
        for part, count in ((0.25, COARSE), (0.03, 4 * COARSE))[: 1 + wanders]:
            bins, length = Bins.of(residual.time_s, count), part * float(np.ptp(residual.time_s))
            wavering = course(tone.sums(residual, bins), length, _sizes(residual))
            yield Candidate(tone, "tone", wavering.evidence - penalty, bins, length, wavering.variance)


def _pace_hz(residual: Residual) -> float:
    """Return a frequency above which the field as the sensors see it hardly changes."""
    rate = np.gradient(residual.field, residual.time_s, axis=0)
    return 2 / np.pi * float(np.sqrt(np.mean(rate**2) / residual.field.var(axis=0).mean()))


def _line(residual: Residual, pattern: Pattern) -> tuple[float | None, int]:
    """Return the frequency of most power in the scores of a pattern, and how many were tried."""
    from scipy.optimize import minimize_scalar

    score = np.einsum("nrp,nr->np", pattern.features, pattern.of_rows(residual).score[:, :, 0])
    values, vectors = np.linalg.eigh(pattern.normal(residual).information / residual.count)
    kept = values > 1e-6 * values[-1]
    score = score @ (vectors[:, kept] / np.sqrt(values[kept]))
    time_s = residual.time_s - residual.time_s[0]
    step_s = float(np.median(np.diff(time_s)))
    slot = np.round(time_s / step_s).astype(int)
    if slot[-1] > 16 * len(slot):
        return None, 1
    length = 4 << int(np.ceil(np.log2(slot[-1] + 1)))
    power = np.zeros(length // 2 + 1)
    for column in score.T:  # one after another, as a long recording has many slots
        power += np.abs(np.fft.rfft(np.bincount(slot, column, length))) ** 2
    frequency = np.fft.rfftfreq(length, step_s)
    slowest = 12 / time_s[-1]  # a slower one is a drift
    if pattern.law != "offset":  # and one of the pace of the motion a function of that
        slowest = max(slowest, _pace_hz(residual))
    power[frequency < slowest] = 0
    near, spacing = float(frequency[power.argmax()]), float(frequency[1])  # a quarter of a line's width

    def loss(at: float) -> float:
        return -float((np.abs(np.exp(-2j * np.pi * at * time_s) @ score) ** 2).sum())

    options = {"xatol": 1e-4 * spacing}
    found = minimize_scalar(loss, bounds=(near - spacing, near + spacing), method="bounded", options=options)
    return float(found.x), max(len(frequency) // 4, 1)


def _over_reading(residual: Residual, sensor: int) -> Iterator[Candidate]:
    """Yield any function of an axis' own reading, the same both ways or not."""
    for axis, row in enumerate(patterns.sensor_rows(sensor)):
        reading = residual.sensed[:, row]
        pattern = patterns.of_axis("own_field", sensor, axis, np.ones((residual.count, 1)))
        for branch in (None, np.sign(residual.sensed_rate[:, row])):
            bins = Bins.of(reading, min(256, max(residual.count // 4, 4)), branch)
            sums = pattern.sums(residual, bins)
            for part in (0.5, 0.1, 0.02):
                length = part * float(np.ptp(reading))
                fit = course(sums, length, _sizes(residual))
                yield Candidate(pattern, "motion", fit.evidence - 1, bins, length, fit.variance)
