"""What changed within a recording: sensors or axes that are exchanged, a bias, a gain, or the field of all sensors.

The longer part is calibrated. Each hypothesis says how the readings of the other part would have looked without the
change. The one whose sensors then agree best with each other and with the intensity is named; parameters that it has
free count against it (Schwarz 1978).
"""

from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product
from operator import itemgetter

import numpy as np
from numpy.linalg import LinAlgError, inv, norm
from numpy.typing import NDArray

from tam_calibration.core.noise import WHITE
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.change_within import Span, find_change, steady_intensity
from tam_calibration.fit.consistency import LEAVE_OUT, PARTS_APART
from tam_calibration.fit.ellipsoid import normalize, principal_form, sphere_center
from tam_calibration.fit.maximum_likelihood import estimate
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording, SampleSource
from tam_calibration.model.units import FloatArray, rounded, to_degrees, to_nanotesla

_MOST_ORDERED = 4
"""Sensors of which every order is tried, 24 of four; of more, each exchange of two."""


@dataclass(frozen=True, eq=False)
class PartModel:
    """The calibration of one part of a recording, and the samples that are judged by it.

    Parameters
    ----------
    unmix : (K, 3, 3) array
        From readings without bias to fields.
    bias_T : (K, 3) array
        Tesla.
    samples : Recording
        Of K sensors, which are judged.
    intensity_T : float
        Of the field where there is no scalar, tesla.
    array : KnownNoiseArray
        Of the sensors.
    """

    unmix: FloatArray
    bias_T: FloatArray
    samples: Recording
    intensity_T: float
    array: KnownNoiseArray

    @classmethod
    def of(cls, recording: Recording, array: KnownNoiseArray) -> "PartModel | None":
        """Calibrate a part of a recording with sensors of any hand; None where its readings do not determine that."""
        data = normalize(recording)
        try:
            matrix, bias = principal_form(data, *data.noise_of(array))
            unmix = inv(matrix)
        except (InputError, LinAlgError):
            return None
        return cls(unmix, data.origin_T + data.radius_T * bias, recording, data.radius_T, array)

    @property
    def channels(self) -> int:
        """Channels of a sample in which sensors contradict each other or the intensity."""
        return 3 * len(self.unmix) - 2

    @property
    def intensities_T(self) -> FloatArray | float:
        """Intensity of the field in each sample (N,), or in all, tesla."""
        return self.intensity_T if self.samples.scalar_T is None else steady_intensity(self.samples)

    def fields(self, readings_T: FloatArray) -> FloatArray:
        """Return the fields (N, K, 3) of readings, tesla."""
        return np.asarray(np.einsum("kij,nkj->nki", self.unmix, readings_T - self.bias_T))

    def field(self, sensor: int, readings_T: FloatArray) -> FloatArray:
        """Return the field (N, 3) of readings of one sensor, tesla."""
        return np.asarray((readings_T - self.bias_T[sensor]) @ self.unmix[sensor].T)

    def readings(self, sensor: int, fields_T: FloatArray) -> FloatArray:
        """Return what a sensor reads (N, 3) in the mean field of the other sensors."""
        others = (fields_T.sum(axis=1) - fields_T[:, sensor]) / (fields_T.shape[1] - 1)
        return np.asarray(others @ inv(self.unmix[sensor]).T + self.bias_T[sensor])

    def variance(self, fields_T: FloatArray) -> float:
        """Return the mean square of how fields differ from each other and from the intensity, over the noise."""
        noise_T2 = float(np.mean(self.array.vector_noise_T**2))
        mean_T = fields_T.mean(axis=1)
        scalar_T2 = self.array.scalar_noise_T**2 if self.samples.scalar_T is not None else 0.0
        energy = np.sum((fields_T - mean_T[:, None]) ** 2) / noise_T2
        energy += np.sum((norm(mean_T, axis=1) - self.intensities_T) ** 2) / (noise_T2 / fields_T.shape[1] + scalar_T2)
        return float(energy / (len(fields_T) * (3 * fields_T.shape[1] - 2)))


Hypothesis = tuple[str, FloatArray, int]
"""What may have changed in words, the fields (N, K, 3) that it makes of the readings, and its free parameters."""


def hypotheses(model: PartModel, unchanged_T: FloatArray, sign: int) -> Iterator[Hypothesis]:
    """Yield what may have changed in a part of a recording, the simplest first.

    Parameters
    ----------
    model : PartModel
        Of the other part, with the samples of this one.
    unchanged_T : (N, K, 3) array
        Fields without a change, tesla.
    sign : int
        1 where this part differs from the others before or around it, and -1 where those differ from it.
    """
    readings_T = model.samples.readings_T
    for order in _orders(readings_T.shape[1]):
        named = order if sign < 0 else np.argsort(order).tolist()
        yield _of_order(named), model.fields(readings_T[:, order]), 0
    distance = np.median(norm(unchanged_T - np.median(unchanged_T, axis=1, keepdims=True), axis=2), axis=0)
    for sensor in np.argsort(-distance)[:_MOST_ORDERED].tolist():
        for words, field_T, free in _of_sensor(model, unchanged_T, sensor, sign):
            changed_T = unchanged_T.copy()
            changed_T[:, sensor] = field_T
            yield words.format(f"sensor {sensor + 1}"), changed_T, free
    yield from _of_all(model, unchanged_T, sign)


def _orders(count: int) -> list[list[int]]:
    """Return in which orders sensors may be, without the usual one."""
    usual = list(range(count))
    if count <= _MOST_ORDERED:
        return [list(order) for order in permutations(usual)][1:]
    return [[{one: other, other: one}.get(each, each) for each in usual] for one, other in combinations(usual, 2)]


def _of_order(order: list[int]) -> str:
    moved = [place + 1 for place, sensor in enumerate(order) if place != sensor]
    if len(moved) == 2:
        return f"sensors {moved[0]} and {moved[1]} are exchanged"
    return f"the sensors are in the order {', '.join(str(sensor + 1) for sensor in order)}"


def _of_sensor(
    model: PartModel, unchanged_T: FloatArray, sensor: int, sign: int
) -> Iterator[tuple[str, FloatArray, int]]:
    """Yield what may have changed in one sensor, its field (N, 3) if it did, and the number of free parameters."""
    own_T = model.samples.readings_T[:, sensor]
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        if order != (0, 1, 2) or -1 in signs:
            yield _of_axes(order, signs), model.field(sensor, own_T[:, order] * signs), 0
    for other in set(range(unchanged_T.shape[1])) - {sensor}:
        yield f"{{}} reads what sensor {other + 1} reads", model.field(other, own_T), 0
    if unchanged_T.shape[1] == 1:
        return
    expected_T = model.readings(sensor, unchanged_T)
    jump_T = (own_T - expected_T).mean(axis=0)
    slope = np.sum(own_T * expected_T, axis=0) / np.sum(expected_T**2, axis=0)
    slope[slope == 0] = 1.0  # an axis that reads zero has no gain
    for axis, name in enumerate("xyz"):
        divisor = np.where(np.arange(3) == axis, slope, 1)
        yield _of_gain(f"{{}} {name}", slope[axis] ** sign), model.field(sensor, own_T / divisor), 1
    gain = float(np.sum(own_T * expected_T) / np.sum(expected_T**2)) or 1.0
    yield _of_gain("{}", gain**sign), model.field(sensor, own_T / gain), 1
    yield _of_bias("{}", sign * jump_T), model.field(sensor, own_T - jump_T), 3
    delay_s, shifted_T = _undelayed(model, unchanged_T, sensor)
    yield f"the readings of {{}} come {abs(delay_s):.2g} s {'later' if sign * delay_s > 0 else 'earlier'}", shifted_T, 1
    design = np.column_stack([own_T, np.ones(len(own_T))])
    affine = np.linalg.lstsq(design, expected_T, rcond=None)[0]
    yield _of_matrix(affine[:3]), model.field(sensor, design @ affine), 12


def _undelayed(model: PartModel, unchanged_T: FloatArray, sensor: int) -> tuple[float, FloatArray]:
    """Return by how many seconds a sensor's field lags behind that of the others, and its field (N, 3) without."""
    time_s, own_T = model.samples.time_s, unchanged_T[:, sensor]
    others_T = np.delete(unchanged_T, sensor, axis=1).mean(axis=1)
    rate = np.gradient(others_T, time_s, axis=0)
    delay_s, shifted_T = 0.0, own_T
    # Gauss-Newton steps for a delay: of a tenth of a turn two leave a thousandth of it.
    for _ in range(3):
        delay_s -= float(np.sum((shifted_T - others_T) * rate) / np.sum(rate**2))
        read_s = time_s + delay_s
        is_read = (read_s >= time_s[0]) & (read_s <= time_s[-1])
        moved_T = np.column_stack([np.interp(read_s, time_s, axis_T) for axis_T in own_T.T])
        shifted_T = np.where(is_read[:, None], moved_T, others_T)
    return delay_s, shifted_T


def _of_axes(order: tuple[int, ...], signs: tuple[int, ...]) -> str:
    turned = " and ".join(name for name, each in zip("xyz", signs, strict=True) if each < 0)
    moved = [name for place, name in enumerate("xyz") if order[place] != place]
    if not moved:
        return f"the sign of {{}} {turned} changes"
    exchanged = f"axes {', '.join(moved)} of {{}} are exchanged"
    return f"{exchanged}, and the sign of {turned} changes" if turned else exchanged


def _of_bias(whose: str, jump_T: FloatArray) -> str:
    axis = int(np.argmax(np.abs(jump_T)))
    # Largest part of a jump across an axis that is said to be along it.
    if np.abs(np.delete(jump_T, axis)).max() < 0.1 * np.abs(jump_T[axis]):
        return f"the bias of {whose} {'xyz'[axis]} changes by {_in_nanotesla(jump_T[axis])} nT"
    return f"the bias of {whose} changes by ({', '.join(map(_in_nanotesla, jump_T))}) nT"


def _in_nanotesla(tesla: float) -> str:
    """Return a number with two digits."""
    return rounded(to_nanotesla(tesla))


def _of_gain(whose: str, factor: float) -> str:
    return f"the gain of {whose} changes by a factor of {factor:.4g}"


def _of_matrix(matrix: FloatArray) -> str:
    left, _, right = np.linalg.svd(matrix)
    turn = left @ right
    # Largest difference of a matrix from a rotation, which is then said to be one.
    if np.abs(matrix - turn).max() > 0.02 or np.linalg.det(turn) < 0:
        return "the gains, axes and biases of {} change"
    return f"{{}} is turned by {to_degrees(float(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))):.2g}°"


def _of_all(model: PartModel, unchanged_T: FloatArray, sign: int) -> Iterator[Hypothesis]:
    """Yield what may have changed in all sensors: the gain, the bias of each, or the iron around them."""
    count, mean_T = unchanged_T.shape[1], unchanged_T.mean(axis=1)
    factor = float(np.mean(norm(mean_T, axis=1) / model.intensities_T))
    words = _of_gain("all sensors" if count > 1 else "sensor 1", factor**sign)
    yield words, model.fields(model.samples.readings_T / factor), 1
    jumps_T = sphere_center(np.swapaxes(unchanged_T, 0, 1))
    alone = _of_bias("sensor 1", sign * inv(model.unmix[0]) @ jumps_T[0])
    yield _of_biases(jumps_T) if count > 1 else alone, unchanged_T - jumps_T, 3 * count
    noise = KnownNoiseArray(np.zeros((1, 3)), model.array.vector_noise_T[:1], model.array.scalar_noise_T)
    together = PartModel.of(replace(model.samples, readings_T=mean_T[:, None]), noise)
    if count > 1 and together is not None:
        fields_T = (unchanged_T - together.bias_T) @ together.unmix[0].T
        yield "iron that moves with the array changes the field of all sensors", fields_T, 9


def _of_biases(jumps_T: FloatArray) -> str:
    mean_T, size_T = jumps_T.mean(axis=0), norm(jumps_T, axis=1)
    largest = _in_nanotesla(float(size_T.max()))
    # Cosine of the jumps of all sensors and their mean from which one magnet makes them.
    if np.all(jumps_T @ mean_T > 0.9 * size_T * norm(mean_T)):
        return f"something magnetic adds up to {largest} nT to all sensors"
    many = [str(sensor + 1) for sensor in np.flatnonzero(size_T > size_T.max() / 10)]
    whose = "all sensors" if len(many) == len(size_T) else f"sensors {', '.join(many)}"
    return f"the biases of {whose} change by up to {largest} nT"


_EXPLAINED = 2.0
"""Largest variance of residuals over that of the calibrated part, whose directions may differ, or of this part over the
noise: above it chance is not that of white noise."""


@dataclass(frozen=True, eq=False)
class Change:
    """What changed, and when.

    Parameters
    ----------
    what : str
        In one clause, with the time: "sensors 1 and 3 are exchanged from 100.0 s on".
    todo : str
        What to do.
    is_calibrated : (N,) array of bool
        Samples of the recording, which one calibration describes; those of the longer part where two are possible.
    is_plain : bool
        Whether it is so large that no slow noise looks like it.
    is_explained : bool
        Whether both parts are calibrations: no sensor fails in one of them.
    """

    what: str
    todo: str
    is_calibrated: NDArray[np.bool_]
    is_plain: bool
    is_explained: bool = True

    @property
    def sentence(self) -> str:
        """What changed when, and what to do."""
        return f"{self.what}: {self.todo}"


@contextmanager
def naming_changes(recording: SampleSource, array: Array) -> Iterator[None]:
    """Say of a failing fit what changed within the recording, where something did.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors in a uniform field.
    array : Array
        Of these sensors; a noise that is not stated is estimated.
    """
    try:
        yield
    except (InputError, Refused) as problem:
        if change := what_changed(recording, array):
            raise Refused(change.sentence) from problem
        raise


def despite_changes(
    calibration: Calibration, recording: SampleSource, array: Array, accept: Collection[str]
) -> Calibration:
    """Return a calibration with a warning of what changed within its recording, and with wider standard errors.

    Nothing is looked for where the residual is white noise of the stated size.

    Parameters
    ----------
    calibration : Calibration
        Of the whole recording.
    recording : SampleSource
        Raw readings.
    array : Array
        Of the sensors, as it was given.
    accept : collection of str
        Names of findings that shall refuse nothing: with "residual" a change is a warning, however large.

    Raises
    ------
    Refused
        When the change is plain, and the calibration is more than three standard errors from that of the longer part.
    """
    left = max(calibration.reduced_chi_square.values(), default=1.0)
    if left < _EXPLAINED and calibration.variance_factors == WHITE:
        return calibration
    change = what_changed(recording, array)
    if change is None:
        return calibration
    off = None
    with suppress(InputError, Refused):
        alone = estimate(recording.take(change.is_calibrated), calibration.array)
        off = (calibration.errors.to_vector() - alone.to_vector()).ravel()
    # Standard errors by which the calibration of all readings may differ from that of the longer part.
    is_wrong = off is None or bool(np.any(np.abs(off) > 3.0 * calibration.standard_errors.ravel()))
    if change.is_plain and is_wrong and "residual" not in accept:
        raise Refused(change.sentence)
    calibration = replace(calibration, warnings=(change.sentence, *calibration.warnings))
    if off is None:
        return calibration
    return replace(calibration, covariance=calibration.covariance + np.outer(off, off))


def what_changed(recording: SampleSource, array: Array) -> Change | None:
    """Return what changed within a recording; None where nothing did at one time, or by no more than chance.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors in a uniform field; a large recording is thinned.
    array : Array
        Of these sensors; a noise that is not stated is estimated.
    """
    span = find_change(recording, array)
    parts = None if span is None else _Parts.of(span)
    if span is None or parts is None:
        return None
    unchanged_T = parts.model.fields(parts.model.samples.readings_T)
    before = parts.ratio(unchanged_T)
    after, words = parts.best_hypothesis(unchanged_T)
    gained = (before - after) * len(unchanged_T) * parts.model.channels
    # Least energy that a hypothesis explains beyond its price where noise is white: chance makes less than its
    # price.
    # Least ratio of the variances of both parts' residuals where the noise is not white: a room leaves a half or
    # twice.
    if gained < 50.0 if parts.level < _EXPLAINED else before < 4.0:
        return None
    is_calibrated = span.of_all(parts.is_calibrated, recording.sample_count)
    # Part of the residuals' energy that a hypothesis may leave in any case: 3 % of their size, which are side
    # effects.
    is_explained = after < max(min(_EXPLAINED, (1 + before) / 2), 1e-3 * before)
    if is_explained and (parts.are_steady or after < _EXPLAINED):
        return Change(*_in_words(span, words), is_calibrated, span.is_plain)
    # Variance of the residuals over that of the calibrated part from which readings fail that nothing explains.
    if before < 100.0:
        return None
    if sensor := parts.failing_sensor(unchanged_T):
        words = f"sensor {sensor} contradicts the others"
        return Change(*_failing_in_words(span, words, parts.is_inside), is_calibrated, span.is_plain, False)
    if parts.are_steady and parts.are_calibrations:
        return Change(*_in_words(span, "the readings follow another calibration"), is_calibrated, span.is_plain)
    return None


@dataclass(frozen=True, eq=False)
class _Parts:
    """The part of a recording that is calibrated, and the other one that is compared with it.

    Parameters
    ----------
    is_calibrated : (N,) array of bool
        Samples of the thinned recording that are calibrated.
    level : float
        Variance of their residuals over that of the noise.
    model : PartModel
        Their calibration, with the other samples.
    is_inside : bool
        Whether the other samples are those within the span.
    are_steady, are_calibrations : bool
        Whether neither part holds a further change, and whether each of them is one calibration.
    """

    is_calibrated: NDArray[np.bool_]
    level: float
    model: PartModel
    is_inside: bool
    are_steady: bool
    are_calibrations: bool

    @classmethod
    def of(cls, span: Span) -> "_Parts | None":
        """Calibrate the longer part, or the other where that is no calibration; None where that cannot be done."""
        parts = sorted((span.is_inside, ~span.is_inside), key=np.mean)
        models = [PartModel.of(span.some.take(part), span.array) for part in parts]
        variances = [model.variance(model.fields(model.samples.readings_T)) if model else np.inf for model in models]
        steady = [span.inside_is_steady if part[span.first] else span.outside_is_steady for part in parts]
        # Ratio of the residuals' variances from which the shorter part is calibrated: readings that are none fit
        # nothing.
        best = int(variances[1] < 16.0 * variances[0]) if all(steady) else steady.index(True)
        # Least variance of the residuals over that of the noise.
        model, level = models[best], max(variances[best], 1e-3)
        if model is None:
            return None
        other = replace(model, samples=span.some.take(parts[1 - best]))
        is_inside = bool(parts[1 - best][span.first])
        return cls(parts[best], level, other, is_inside, all(steady), max(variances) < _EXPLAINED * level)

    def ratio(self, fields_T: FloatArray) -> float:
        """Return the variance of the other part's residuals over that of the calibrated one's."""
        return self.model.variance(fields_T) / self.level

    def best_hypothesis(self, unchanged_T: FloatArray) -> tuple[float, str]:
        """Return the least ratio that a hypothesis leaves, with the price of its free parameters, and its words."""
        count = len(unchanged_T) * self.model.channels
        # Times the price of a free parameter by Schwarz 1978: the calibrated part has errors of its own.
        price = 3.0 * np.log(count) / count
        tried = hypotheses(self.model, unchanged_T, 1 if self.is_inside else -1)
        return min(((self.ratio(fields_T) + price * free, words) for words, fields_T, free in tried), key=itemgetter(0))

    def failing_sensor(self, unchanged_T: FloatArray) -> int:
        """Return the number of the sensor that contradicts the others, where these agree; 0 where they do not."""
        count = unchanged_T.shape[1]
        without = [self.ratio(np.delete(unchanged_T, sensor, axis=1)) for sensor in range(count)] if count > 1 else []
        return int(np.argmin(without)) + 1 if min(without, default=np.inf) < _EXPLAINED else 0


def _in_words(span: Span, words: str) -> tuple[str, str]:
    """Say what is otherwise within a span, and what to do."""
    first, last = _times(span)
    when = f"between {first} and {last} s" if last else f"from {first} s on"
    return f"{words} {when}", f"{PARTS_APART} (--until {first}, --from {last or first})"


def _failing_in_words(span: Span, words: str, is_inside: bool) -> tuple[str, str]:
    """Say what fails within a span, or at all other times, and what to do."""
    first, last = _times(span)
    if is_inside:
        when, options = _in_words(span, words)[0], f"--until {first}{f', or --from {last}' if last else ''}"
    else:
        when = f"{words} but for the time between {first} and {last} s" if last else f"{words} until {first} s"
        options = f"--from {first}{f' --until {last}' if last else ''}"
    return when, f"{LEAVE_OUT} ({options})"


def _times(span: Span) -> tuple[str, str]:
    """Return in seconds from the first sample when a span begins, and when it ends; empty where it lasts."""
    time_s = span.some.time_s - span.some.time_s[0]
    return f"{time_s[span.first]:.1f}", f"{time_s[span.last]:.1f}" if span.last < len(time_s) else ""
