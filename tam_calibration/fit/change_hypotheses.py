"""What may have changed between two parts of a recording, and the fields that the readings show if it did."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product

import numpy as np
from numpy.linalg import LinAlgError, inv, norm

from tam_calibration.fit.change_within import steady_intensity
from tam_calibration.fit.maximum_likelihood import principal_form
from tam_calibration.fit.scale import normalize, sphere_center
from tam_calibration.model.array import KnownNoiseArray
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray, to_degrees, to_nanotesla

_IS_ROTATION = 0.02
"""Largest difference of a matrix from a rotation, which is then said to be one."""

_PARALLEL = 0.9
"""Cosine of the jumps of all sensors and their mean from which one magnet makes them."""

_ALONG = 0.1
"""Largest part of a jump across an axis that is said to be along it."""

_MOST_ORDERED = 4
"""Sensors of which every order is tried, 24 of four; of more, each exchange of two."""

_DELAY_STEPS = 3
"""Gauss-Newton steps for a delay: of a tenth of a turn two leave a thousandth of it."""


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
        scalar = array.scalar_noise_T / data.radius_T if data.has_scalar else 0.0
        try:
            matrix, bias = principal_form(data, array.vector_noise_T / data.radius_T, scalar)
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


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """What may have changed in words, the fields (N, K, 3) that it makes of the readings, and its free parameters."""

    words: str
    fields_T: FloatArray
    free: int


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
        yield Hypothesis(_of_order(named), model.fields(readings_T[:, order]), 0)
    distance = np.median(norm(unchanged_T - np.median(unchanged_T, axis=1, keepdims=True), axis=2), axis=0)
    for sensor in np.argsort(-distance)[:_MOST_ORDERED].tolist():
        for words, field_T, free in _of_sensor(model, unchanged_T, sensor, sign):
            changed_T = unchanged_T.copy()
            changed_T[:, sensor] = field_T
            yield Hypothesis(words.format(f"sensor {sensor + 1}"), changed_T, free)
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
    for _ in range(_DELAY_STEPS):
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
    if np.abs(np.delete(jump_T, axis)).max() < _ALONG * np.abs(jump_T[axis]):
        return f"the bias of {whose} {'xyz'[axis]} changes by {_in_nanotesla(jump_T[axis])} nT"
    return f"the bias of {whose} changes by ({', '.join(map(_in_nanotesla, jump_T))}) nT"


def _in_nanotesla(tesla: float) -> str:
    """Return a number with two digits."""
    return f"{float(f'{to_nanotesla(tesla):.2g}'):g}"


def _of_gain(whose: str, factor: float) -> str:
    return f"the gain of {whose} changes by a factor of {factor:.4g}"


def _of_matrix(matrix: FloatArray) -> str:
    left, _, right = np.linalg.svd(matrix)
    turn = left @ right
    if np.abs(matrix - turn).max() > _IS_ROTATION or np.linalg.det(turn) < 0:
        return "the gains, axes and biases of {} change"
    return f"{{}} is turned by {to_degrees(float(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))):.2g}°"


def _of_all(model: PartModel, unchanged_T: FloatArray, sign: int) -> Iterator[Hypothesis]:
    """Yield what may have changed in all sensors: the gain, the bias of each, or the iron around them."""
    count, mean_T = unchanged_T.shape[1], unchanged_T.mean(axis=1)
    factor = float(np.mean(norm(mean_T, axis=1) / model.intensities_T))
    words = _of_gain("all sensors" if count > 1 else "sensor 1", factor**sign)
    yield Hypothesis(words, model.fields(model.samples.readings_T / factor), 1)
    jumps_T = sphere_center(np.swapaxes(unchanged_T, 0, 1))
    alone = _of_bias("sensor 1", sign * inv(model.unmix[0]) @ jumps_T[0])
    yield Hypothesis(_of_biases(jumps_T) if count > 1 else alone, unchanged_T - jumps_T, 3 * count)
    noise = KnownNoiseArray(np.zeros((1, 3)), model.array.vector_noise_T[:1], model.array.scalar_noise_T)
    together = PartModel.of(replace(model.samples, readings_T=mean_T[:, None]), noise)
    if count > 1 and together is not None:
        fields_T = (unchanged_T - together.bias_T) @ together.unmix[0].T
        yield Hypothesis("iron that moves with the array changes the field of all sensors", fields_T, 9)


def _of_biases(jumps_T: FloatArray) -> str:
    mean_T, size_T = jumps_T.mean(axis=0), norm(jumps_T, axis=1)
    largest = _in_nanotesla(float(size_T.max()))
    if np.all(jumps_T @ mean_T > _PARALLEL * size_T * norm(mean_T)):
        return f"something magnetic adds up to {largest} nT to all sensors"
    many = [str(sensor + 1) for sensor in np.flatnonzero(size_T > size_T.max() / 10)]
    whose = "all sensors" if len(many) == len(size_T) else f"sensors {', '.join(many)}"
    return f"the biases of {whose} change by up to {largest} nT"
