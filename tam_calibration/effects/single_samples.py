"""Effects on single samples: spikes, and readings of a sensor that belong to another sample.

An outlier is a reading, or a burst of a few, that is far off while its neighbours are not. The gain is that of the
mean-shift model (Cook and Weisberg 1982): each flagged sample has shifts of its own. They are penalised by their code
length: k positions among N samples take ln C(N, k) nats and a shift of variance v ½ ln v, where BIC takes ½ ln n per
parameter; that is about two parameters for a single spike, fewer for each of many.

Displaced readings are those that a driver repeats, delivers late, or fills in. A sensor is compared with the field that
all others measure, calibrated by the better half of the samples, so that the displaced ones do not tilt it. A sample
counts as displaced where another sample's reading lowers its energy by more than the code length of the sample and the
displacement, 2 ln (N k), and leaves no more than noise reaches once in N samples.

Such effects are simulated as bursts of samples that something strikes at random times.
"""

from abc import abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from tam_calibration.core.least_squares import ridged
from tam_calibration.core.noise import noise_deviation, noise_energy
from tam_calibration.effects.effect import ALL, Contribution, Covariates, Finding, FoundEffect
from tam_calibration.effects.grades import LONGEST_BURST, MINOR, MOST, NEGLIGIBLE
from tam_calibration.effects.recursions import Memory
from tam_calibration.effects.residuals import Place, WhitenedResiduals, places
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import BLOCK
from tam_calibration.model.units import FloatArray

A_DOZEN = 12
"""Single readings that are no noise, whatever part of a short recording they are: a sixth of 72 poses."""

LATEST = 8
"""Longest delay of a reading, in samples: the length of a usual queue."""


class Outliers(FoundEffect):
    """Spikes in single readings."""

    def find(self, residuals: WhitenedResiduals) -> Finding | str:
        """Return the spikes, flagged, or why there is none."""
        rows = find_spikes(residuals)
        if isinstance(rows, str):
            return rows
        flagged = rows >= 0
        samples = np.flatnonzero(flagged)
        rest = ~flagged & (residuals.channel_count > 0)
        floor = float(residuals.energy[rest].sum() / residuals.channel_count[rest].sum())
        place, saved, value_cost = _best_place(residuals, samples, floor)
        parts = []
        for sensor, axis in place.contribution_keys():
            own = rows[samples] if sensor == ALL else [[row] for row in place.rows if axis is None or row % 3 == axis]
            shift = residuals.row_shift_T[samples, own]
            size = float(np.sqrt(np.mean(shift**2)))
            values, errors = bursts_of(flagged)
            errors["size"] = size / float(np.sqrt(2 * shift.size))
            parts.append(Contribution(sensor, axis, "spikes", values | {"size": size}, errors))
        nats = position_nats(len(flagged), len(samples)) + value_cost / 2
        return self.of_samples(parts, residuals, flagged, saved, 1, nats)

    def put(self, rows_T: FloatArray, part: Contribution, run: Covariates, source: Generator) -> FloatArray:
        """Return the readings (N, n) of the n rows that a contribution acts on with the effect; see `FoundEffect`."""
        bursts = drawn_bursts(part, run, source)
        return rows_T + bursts.is_struck[:, None] * bursts.source.normal(0, part.values["size"], rows_T.shape)


def find_spikes(residuals: WhitenedResiduals) -> NDArray[np.intp] | str:
    """Return the row that explains most of each isolated outlier and -1 at other samples (N,), or why there is none."""
    from scipy.ndimage import label

    usable = residuals.channel_count > 0
    deviation = np.abs(residuals.row_deviations) * usable[:, None]
    # The row that explains most, not the largest residual: noise of one row affects all.
    worst = deviation.argmax(axis=1)
    size = 50  # samples of a block, of which the median tells the local noise
    blocks = max(len(worst) // size, 1)
    local = noise_deviation(deviation[: blocks * size].reshape(blocks, -1, deviation.shape[1]), axis=1)
    samples = np.arange(len(worst))
    scale = np.maximum(local[np.minimum(samples // size, blocks - 1), worst], 1.0)
    far = deviation[samples, worst] > 5.0 * scale  # one of a million values of white noise is
    runs, _ = label(far)
    far &= np.bincount(runs)[runs] <= LONGEST_BURST
    if not far.any():
        return f"no reading is far off for at most {LONGEST_BURST} samples"
    if far.sum() > max(MINOR * usable.sum(), A_DOZEN):
        return f"{far.sum()} of {usable.sum()} samples are too many for spikes"
    return np.where(far, worst, -1)


def without_spikes(residuals: WhitenedResiduals) -> WhitenedResiduals:
    """Return a residual in which the samples of isolated outliers do not count."""
    rows = find_spikes(residuals)
    return residuals if isinstance(rows, str) else replace(residuals, is_counted=residuals.is_counted & (rows < 0))


def _best_place(residuals: WhitenedResiduals, samples: NDArray[np.intp], floor: float) -> tuple[Place, float, float]:
    """Return where the spikes are, the energy that they explain there, and twice the nats of their values.

    Spikes are Gaussian of one variance v of the whitened shift: twice the log likelihood ratio against the floor is
    the energy less d (1 + ln v) for each of d shifts, at the best v.
    """
    found = []
    for place, energy, freedom, choices in _offers(residuals, samples):
        total = len(samples) * freedom
        variance = max(energy / floor / total, 1.0)
        cost = total * float(1 + np.log(variance)) + 2 * len(samples) * float(np.log(choices))
        found.append((place, energy, cost))
    return max(found, key=lambda item: item[1] / floor - item[2])


def _offers(residuals: WhitenedResiduals, samples: NDArray[np.intp]) -> Iterator[tuple[Place, float, int, int]]:
    """Yield places with the energy that spikes explain there, the shifts of a sample, and among how many rows each is.

    Of several sensors, spikes may be in all rows at once, or each in a row of its own.
    """
    count = residuals.covariates.sensor_count
    for place in places(count)[count == 1 :]:
        yield place, float(residuals.explained_energy(samples, place.rows).sum()), len(place.rows), 1
    if count > 1:
        whole, channels = Place(ALL, tuple(range(3 * count))), int(np.median(residuals.channel_count[samples]))
        yield whole, float(residuals.energy[samples].sum()), channels, 1
        single = residuals.row_deviations[samples]
        yield whole, float(np.max(single**2, axis=1).sum()), 1, 3 * count + 1


class Bursts(NamedTuple):
    """Bursts of samples that something strikes at random times.

    Parameters
    ----------
    is_struck : (N,) array of bool
        Whether a sample is in a burst.
    latest : (N,) array of int
        Index at which the latest burst up to each sample began; negative before the first of these samples.
    source : numpy.random.Generator
        Of further random numbers.
    """

    is_struck: NDArray[np.bool_]
    latest: NDArray[np.intp]
    source: Generator


def drawn_bursts(part: Contribution, run: Covariates, source: Generator) -> Bursts:
    """Draw bursts of samples; one at the end of a batch goes on in the next.

    Parameters
    ----------
    part : Contribution
        With the ``rate``, the part of all samples that is struck, and the ``burst`` in samples, by default one.
    run : Covariates
        Of the N samples of a run, or of a batch, with the memory of those before.
    source : numpy.random.Generator
        Source of the random numbers.

    Raises
    ------
    InputError
        When the rate is no part, or the burst longer than the run.
    """
    rate, burst = part.values["rate"], samples_in(part, "burst", run)
    if not 0 <= rate <= 1:
        raise InputError(f"the rate of {part.term} must be a part of all samples, 0 to 1, not {rate:g}")
    memory = run.memory or Memory()
    since, when, what = memory.recall((burst, *source.spawn(2)))
    index = np.arange(run.sample_count)
    latest = np.maximum.accumulate(np.where(when.random(len(index)) < rate / burst, index, -since))
    memory.keep((int(len(index) - latest[-1]), when, what))
    return Bursts(index - latest < burst, latest, what)


def samples_in(part: Contribution, name: str, run: Covariates) -> int:
    """Return a number of samples, at least and by default one, that a contribution states.

    Parameters
    ----------
    part : Contribution
        Of the effect.
    name : str
        Of the value.
    run : Covariates
        Of the samples of a run, which the number must not exceed; those of a batch may be fewer.

    Raises
    ------
    InputError
        When it does, or is negative.
    """
    number, most = part.values.get(name, 1.0), run.sample_count if run.memory is None else BLOCK
    if not 0 <= number <= most:
        raise InputError(f"the {name} of {part.term} must be at most the {most} samples of the run, not {number:g}")
    return max(1, round(number))


def bursts_of(struck: NDArray[np.bool_]) -> tuple[dict[str, float], dict[str, float]]:
    """Return the part of the samples (N,) that are struck, how many follow each other, and standard errors, by name."""
    samples = np.flatnonzero(struck)
    rate, runs = len(samples) / len(struck), 1 + int(np.sum(np.diff(samples) > 1))
    error = float(np.sqrt(rate * (1 - rate) / len(struck)))
    return {"rate": rate, "burst": len(samples) / runs}, {"rate": error}


def position_nats(sample_count: int, chosen: int) -> float:
    """Return ln C(N, k), the code length of k flagged samples among N, in nats."""
    from scipy.special import gammaln

    return float(gammaln(sample_count + 1) - gammaln(chosen + 1) - gammaln(sample_count - chosen + 1))


class AgainstOthers:
    """One sensor against the field that all others measure, of which there must be one at least.

    Parameters
    ----------
    residuals : WhitenedResiduals
        Of all sensors.
    sensor : int
        Index of the one that is compared.

    Attributes
    ----------
    is_usable : (N,) array of bool
        Samples whose channels are told.
    whitening : (3, 3) array
        ``beyond_T @ whitening`` has unit variance under the noise stated, that of the others included, 1/T.
    calibration_T : (N, 3) array
        What bias and matrix that fit the better half of the samples best change in its readings, tesla.
    beyond_T : (N, 3) array
        Residual beside that: reading minus expected reading, tesla.
    expected_T : (N, 3) array
        Expected reading without bias, tesla.
    """

    def __init__(self, residuals: WhitenedResiduals, sensor: int) -> None:
        own = residuals.directions[3 * sensor : 3 * sensor + 3]
        information = ridged(own @ own.T)
        self.is_usable = residuals.channel_count > 0
        self.whitening = np.linalg.cholesky(information)
        beyond = np.linalg.solve(information, own @ residuals.differential.T).T
        expected = residuals.recording.readings_T[:, sensor] - residuals.covariates.errors.bias_T[sensor] - beyond
        self.calibration_T = self._calibration(beyond, expected)
        self.beyond_T, self.expected_T = beyond - self.calibration_T, expected + self.calibration_T

    def energy(self, shift_T: FloatArray) -> FloatArray:
        """Return the energy (...) of shifts (..., 3) of its readings, in units of the noise stated."""
        return np.asarray(np.sum((shift_T @ self.whitening) ** 2, axis=-1))

    def _calibration(self, beyond_T: FloatArray, expected_T: FloatArray) -> FloatArray:
        """Return the part (N, 3) of a residual that is linear in the expected reading.

        By least trimmed squares (Rousseeuw, Least median of squares regression, J. Am. Stat. Assoc. 79, 1984), so that
        a minority of samples has no influence.
        """
        functions = np.column_stack([np.ones(len(expected_T)), expected_T / np.abs(expected_T).max()])
        usable, beyond = functions[self.is_usable], beyond_T[self.is_usable]
        left = beyond
        for _ in range(8):  # concentration steps
            better = np.argpartition(self.energy(left), len(left) // 2)[: len(left) // 2 + 1]
            own = usable[better]
            values = np.linalg.lstsq(own.T @ own, own.T @ beyond[better], rcond=None)[0]
            left = beyond - usable @ values
        return np.asarray(functions @ values)

    def displaced(self, displacement_T: FloatArray) -> NDArray[np.intp]:
        """Return which displacement each sample (N,) has, -1 for none.

        Parameters
        ----------
        displacement_T : (k, N, 3) array
            Residual that each displacement would cause, tesla.
        """
        from scipy.special import chdtri

        energy = self.energy(self.beyond_T)
        floor, price = noise_energy(energy[self.is_usable], 3), 2 * np.log(displacement_T[..., 0].size)
        samples = np.flatnonzero((energy > price * floor) & self.is_usable)
        left = self.energy(self.beyond_T[samples] - displacement_T[:, samples]) / floor
        best = np.argmin(left, axis=0)
        least = left[best, np.arange(len(samples))]
        claimed = (energy[samples] / floor - least > price) & (least < chdtri(3, 1 / len(energy)))
        which = np.full(len(energy), -1)
        which[samples[claimed]] = best[claimed]
        return which


@dataclass(frozen=True, eq=False)
class Explained:
    """Displaced samples (N,) of one sensor, what is explained of its readings (N, 3), tesla, and the parameters."""

    samples: NDArray[np.bool_]
    shift_T: FloatArray
    contribution: Contribution


def of_their_own(found: list[Explained]) -> list[Explained]:
    """Return what was found without sensors that are displaced in few samples, in all of which another is too.

    A sensor that is displaced moves the field with which the others are compared.
    """
    return [
        one
        for one in found
        if not any(
            (one.samples <= other.samples).all() and one.samples.sum() < MINOR * other.samples.sum() for other in found
        )
    ]


class DisplacedEffect(FoundEffect):
    """Displaced readings of one or several sensors; their samples are excluded.

    Attributes
    ----------
    unseen : str
        What is told where no sensor has any.
    """

    unseen: ClassVar[str]

    @abstractmethod
    def explained(self, residuals: WhitenedResiduals, sensor: int) -> Explained | None:
        """Return the displaced samples of a sensor; None where there are none."""

    def find(self, residuals: WhitenedResiduals) -> Finding | str:
        """Return the displaced samples, flagged, or why there are none."""
        of_sensors = (self.explained(residuals, sensor) for sensor in range(residuals.covariates.sensor_count))
        found = of_their_own([one for one in of_sensors if one is not None])
        if not found:
            return self.unseen
        flagged = np.any([one.samples for one in found], axis=0)
        shift = np.zeros((len(flagged), len(residuals.directions)))
        for one in found:
            shift[:, 3 * one.contribution.sensor :][:, :3] = one.shift_T
        saved = float((residuals.energy - residuals.energy_without(shift))[residuals.is_counted | flagged].sum())
        # What the readings do not prove is told by the positions, which cost nats.
        nats = 0.0 if self.is_certain else sum(position_nats(len(flagged), int(one.samples.sum())) for one in found)
        parts = [one.contribution for one in found]
        return self.of_samples(parts, residuals, flagged, saved, len(parts), nats)


class StaleSamples(DisplacedEffect):
    """Readings of a sensor that are those of some samples before.

    A telegram that goes out before the sensor has a new value holds the last one; a packet that was held up on its way
    is stamped when it comes. The sensor then reads what it should have read k samples before, b(t_n - k): its residual
    is -M (b_n - b_{n-k}), along the path of the field and as large as the way that this has made meanwhile.
    """

    unseen = "no sensor reads at some times what it should have read just before"

    def explained(self, residuals: WhitenedResiduals, sensor: int) -> Explained | None:
        """Return how often and how long readings are stale, and by how much: a value is held, or packets are late."""
        against = AgainstOthers(residuals, sensor)
        back = _ways_back(against.expected_T, residuals.covariates.stretches)
        back = np.concatenate([back, _held(residuals.recording.readings_T[:, sensor], against.expected_T)[None]])
        which = against.displaced(back)
        samples = np.flatnonzero(which >= 0)
        if not 0 < len(samples) < MOST * len(which):
            return None
        late, shift = which[samples] + 1, against.calibration_T.copy()
        shift[samples] += back[late - 1, samples]
        # A held value ages by a sample with each that repeats it.
        starts = samples[np.diff(samples, prepend=-2) > 1]
        since = samples - starts[np.searchsorted(starts, samples, side="right") - 1]
        is_held = np.sum((late == since + 1) | (late > LATEST)) > len(samples) / 2
        values, errors = bursts_of(which >= 0)
        values["samples late"] = 1.0 if is_held else float(np.median(late))
        part = Contribution(sensor, None, "repeats" if is_held else "late packets", values, errors)
        return Explained(which >= 0, shift, part)

    def put(self, rows_T: FloatArray, part: Contribution, run: Covariates, source: Generator) -> FloatArray:
        """Return the readings (N, n) of the n rows that a contribution acts on with the effect; see `FoundEffect`."""
        is_struck, latest, _ = drawn_bursts(part, run, source)
        burst, late = (samples_in(part, name, run) for name in ("burst", "samples late"))
        memory = run.memory or Memory()
        past = memory.recall(rows_T[:0])
        known = np.concatenate([past, rows_T])
        memory.keep(known[-max(burst, late) :])
        taken = latest - 1 if part.term == "repeats" else np.arange(len(rows_T)) - late
        return np.where(is_struck[:, None], known[np.maximum(taken + len(past), 0)], rows_T)


def _ways_back(expected_T: FloatArray, stretches: Iterable[slice]) -> FloatArray:
    """Return the residual (k, N, 3) of readings that are those of 1 to k samples before, tesla."""
    # A tesla where there is no such sample: none is displaced by that.
    back = np.ones((LATEST, *expected_T.shape))
    for stretch in stretches:
        own = expected_T[stretch]
        for late in range(1, min(LATEST, len(own) - 1) + 1):
            back[late - 1, stretch.start + late : stretch.stop] = own[:-late] - own[late:]
    return back


def _held(readings_T: FloatArray, expected_T: FloatArray) -> FloatArray:
    """Return the residual (N, 3) of readings that repeat an earlier one for however long, tesla; a tesla for others."""
    is_new = np.append(True, np.any(np.diff(readings_T, axis=0) != 0, axis=1))
    first = np.maximum.accumulate(np.where(is_new, np.arange(len(is_new)), 0))
    return np.where(is_new[:, None], 1.0, expected_T[first] - expected_T)


class InterpolatedSamples(DisplacedEffect):
    """Lost readings of a sensor, filled on straight lines between their neighbours.

    Where the field is in motion the line cuts its curve short: the residual is the error of linear interpolation, up to
    h²/8 |d²b/dt²| for a gap of duration h. Noise never goes straight in three axes at once: the second differences of
    what was filled vanish, to the last digit that is written.
    """

    unseen = "no sensor reads along straight lines where the others see the field turn"

    def explained(self, residuals: WhitenedResiduals, sensor: int) -> Explained | None:
        """Return the samples that were filled, and what lines between their neighbours leave of the residual."""
        windows = _lines(residuals.recording.readings_T[:, sensor], residuals.covariates)
        if not windows:
            return None
        against = AgainstOthers(residuals, sensor)
        shift, are_filled = against.calibration_T.copy(), np.zeros(len(against.beyond_T), dtype=bool)
        for inside in windows:
            are_filled[inside] = True
            shift[inside] += _on_line(against.expected_T, inside) - against.expected_T[inside]
        return Explained(are_filled, shift, Contribution(sensor, None, "lines", *bursts_of(are_filled)))

    def put(self, rows_T: FloatArray, part: Contribution, run: Covariates, source: Generator) -> FloatArray:
        """Return the readings (N, n) of the n rows that a contribution acts on with the effect; see `FoundEffect`."""
        rows, is_lost = rows_T.copy(), drawn_bursts(part, run, source).is_struck
        for inside in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(is_lost)) + 1):
            if is_lost[inside[0]] and inside[0] > 0 and inside[-1] < len(rows) - 1:
                rows[inside] = _on_line(rows_T, inside)
        return rows


def _lines(readings_T: FloatArray, covariates: Covariates) -> list[NDArray[np.intp]]:
    """Return the samples of each row that goes straight in all axes and is longer than chance lets one be.

    Chance is that of the samples of which some axes go straight, and others do not.
    """
    count = len(readings_T)
    digit = np.array([_digit(axis) for axis in readings_T.T])
    bend, step = np.full((count, 3), np.inf), np.zeros((count, 3))
    for stretch in covariates.stretches:
        if stretch.stop - stretch.start > 2:
            bend[stretch.start + 1 : stretch.stop - 1] = np.diff(readings_T[stretch], 2, axis=0)
            step[stretch.start + 1 : stretch.stop] = np.diff(readings_T[stretch], axis=0)
    goes_straight = np.abs(bend) <= 2 * digit
    is_straight = goes_straight.all(axis=1) & (np.abs(step) > 4 * digit).any(axis=1)
    chance = float(np.prod((goes_straight[~is_straight].sum(axis=0) + 1) / (np.sum(~is_straight) + 1)))
    rows = np.split(np.arange(count), np.flatnonzero(np.diff(is_straight)) + 1)
    return [row for row in rows if is_straight[row[0]] and count * chance ** len(row) < NEGLIGIBLE]


def _digit(values: FloatArray) -> float:
    """Return the smallest step between values (N,) that differ by more than the rounding of the computer."""
    steps = np.diff(np.unique(values))
    return float(np.min(steps[steps > 1e-13 * np.abs(values).max()], initial=np.ptp(values)))


def _on_line(values: FloatArray, inside: NDArray[np.intp]) -> FloatArray:
    """Return values (n, C) on the straight lines between the neighbours of some samples (n,) that follow each other."""
    ends = [max(inside[0] - 1, 0), min(inside[-1] + 1, len(values) - 1)]
    return np.column_stack([np.interp(inside, ends, own) for own in values[ends].T])
