"""Effects whose course in time is recorded, as temperature and current, or their own: a slow drift, a tone."""

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.linalg import norm
from numpy.polynomial.legendre import legvander

from tam_calibration.effects.covariates import LEAST_TURN, to_world
from tam_calibration.effects.effect import Covariates, FittedEffect, LinearEffect, Shape, Sized, Term, WhitenedResiduals
from tam_calibration.effects.grades import LONGEST_BURST, NEGLIGIBLE
from tam_calibration.effects.recursions import lagged
from tam_calibration.effects.term import axis_terms, course_terms, order_terms, scalar_term, sensor_terms, turned
from tam_calibration.model.units import FloatArray

_LEAST_PERIODS = 10
"""Periods in the record at least: slower variation is a drift."""


def _change_of(channel: FloatArray) -> tuple[float, float]:
    """Return the change of a channel (N,) without its extreme per cents, and its largest size there."""
    low, high = np.quantile(channel, (0.01, 0.99))
    return high - low, max(abs(low), abs(high))


class TemperatureDrift(LinearEffect):
    """Bias and scale factor of an axis follow the temperature, with a lag."""

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that the temperature is constant, where it is."""
        change, _ = _change_of(covariates.channel("temperature_C"))
        # Less is the noise of usual thermometers.
        return f"the temperature changes by {change:.2g} K only" if change < 0.2 else None

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return lags from none to a third of the record, of one layer and of two alike.

        A longer lag is a drift with time. As the order of the layers does not matter, the inner one has at most half.
        """
        begin, end = float(covariates.time_s[0]), float(covariates.time_s[-1])
        reference = {"reference_C": float(np.mean(covariates.channel("temperature_C")))}
        return [
            {"time_constant_s": 0.0} | reference,
            *(
                {"time_constant_s": constant, "inner_share": share} | reference | {"start_s": begin}
                for constant in np.geomspace((end - begin) / 200, (end - begin) / 3, 5).tolist()
                for share in (0.0, 0.5)
            ),
        ]

    def terms(self, covariates: Covariates, shape: Shape) -> Iterator[Term]:
        """Yield drifts of offset and scale, the second order of the offset, and how the start settles.

        The shape has ``time_constant_s`` and ``start_s``, seconds, ``reference_C``, °C, and ``inner_share``, part of
        the lag.
        """
        inner = shape.get("inner_share", 0.0) * shape["time_constant_s"]
        outer = shape["time_constant_s"] - inner
        change = covariates.channel("temperature_C") - shape["reference_C"]
        for constant in (outer, inner):
            change = lagged(change, covariates.time_s, constant, covariates.memory)
        courses = [("offset", "T/K", change), ("quadratic offset", "T/K²", change**2)]
        if "start_s" in shape:
            since = covariates.time_s - shape["start_s"]
            left = np.exp(-np.maximum(since, 0.0) / outer) if outer > 0 else since == 0
            courses.append(("start", "T", np.where(since < 0, 0.0, left)))
        for name, unit, course in courses:
            yield from course_terms(covariates, name, {name: unit}, course[:, None])
        yield from axis_terms(covariates, "scale", {"scale": "1/K"}, change[:, None] * covariates.sensed_T)


class CurrentInterference(LinearEffect):
    """A current that is fixed to the array adds a field in proportion to it."""

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that the current is constant, where it is."""
        change, size = _change_of(covariates.channel("current_A"))
        return f"the current changes by {change:.2g} A only" if change <= NEGLIGIBLE * size else None

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return the field without a lagged part, then with one of some steps of time."""
        reference = {"reference_A": float(np.mean(covariates.channel("current_A")))}
        lags = (1.0, 5.0, 25.0, 125.0)
        return [reference, *({**reference, "time_constant_s": lag * covariates.step_s} for lag in lags)]

    def terms(self, covariates: Covariates, shape: Shape) -> Iterator[Term]:
        """Yield the field of the current at each axis and along the field at the scalar, its second order and lag.

        The shape has ``reference_A``, ampere, and with a lagged part ``time_constant_s``, seconds.
        """
        current = (covariates.channel("current_A") - shape["reference_A"])[:, None]
        courses = [("field", "T/A", current), ("quadratic", "T/A²", current**2)]
        if "time_constant_s" in shape:
            late = lagged(current, covariates.time_s, shape["time_constant_s"], covariates.memory)
            courses.append(("lagged", "T/A", current - late))
        for name, unit, course in courses:
            yield from course_terms(covariates, name, {name: unit}, course)
        units = {f"field {axis}": "T/A" for axis in "xyz"}
        yield scalar_term(covariates, "field", units, covariates.direction * current)


class Flexure(LinearEffect):
    """A sensor turns against the array by ω = C u, with u the direction upwards: it reads M (b + ω × b)."""

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that the array was not tilted, or that its sensor has none to turn against, where it is so."""
        if covariates.sensor_count < 2 and not covariates.follows_attitude:
            return "a turn of a single sensor does not change the length of the field"
        tilt = float(np.sqrt(np.sum(np.var(_upwards(covariates), axis=0))))
        return f"the array is tilted by {tilt:.2f} rad only" if tilt < LEAST_TURN else None

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return the nine elements of C of each sensor."""
        units = {f"turn about {axis} by weight along {other}": "rad" for axis in "xyz" for other in "xyz"}
        features = turned(covariates, covariates.field_T)[..., None] * _upwards(covariates)[:, None, None, :]
        return sensor_terms(covariates, "turn", units, features.reshape(*features.shape[:2], 9))


def _upwards(covariates: Covariates) -> FloatArray:
    """Return the (N, 3) direction upwards, against gravity, in the array frame."""
    return to_world(covariates)[:, 2]


ORDERS = ((1, 2), (3, 4), (5, 8), (9, 16), (17, 32))
"""Orders of the functions of a free course in time that stand or fall together, by octaves."""


class GeomagneticDrift(LinearEffect):
    """The intensity at the array drifts against the reference: a free, slow function of time on the scalar row.

    A drift of the vector turns with the array, yet changes the intensity by its part along the field, whatever the
    attitude; the differences between the sensors do not see it.
    """

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that the recording is too short, where it is."""
        if covariates.sample_count < LONGEST_BURST * ORDERS[0][1]:
            return f"{covariates.sample_count} samples are too few for a free function of time"
        return None

    def sizes(self, covariates: Covariates, fitted: FittedEffect) -> list[Sized]:
        """Return how fast the drift is beside the fastest storm: the root of the mean square of its rate."""
        rate = np.diff(self.signal(covariates, fitted)[:, -1]) / np.diff(covariates.time_s)
        name = "rate of change"
        return [Sized(name, float(np.sqrt(np.mean(rate**2))), self.limits[name])] if len(rate) else []

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return the span of time of the recording."""
        start, stop = float(covariates.time_s[0]), float(covariates.time_s[-1])
        return ({"start_s": start, "span_s": stop - start},)

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return Legendre polynomials of time, held at their last value outside the span.

        The shape has ``start_s`` and ``span_s``, over which the polynomials are defined, seconds.
        """
        phase = np.clip(2 * (covariates.time_s - shape["start_s"]) / shape["span_s"] - 1, -1, 1)
        groups = {f"orders {first} to {last}": list(range(first, last + 1)) for first, last in ORDERS}
        return order_terms(covariates, covariates.scalar_row, groups, "order ", legvander(phase, ORDERS[-1][1]))


_MOST_STEPS = 1 << 21
"""Steps of time that a transform spans, of some hundred megabytes."""

_FINER = 4
"""Points of the periodogram per width of a line."""


class PeriodicInterference(LinearEffect):
    """A sinusoid of one frequency with its harmonics; above half the sampling rate it shows at its alias."""

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that the recording is too short, where it is."""
        if covariates.sample_count <= 2 * _LEAST_PERIODS:
            return f"{covariates.sample_count} samples are too few for a spectrum"
        return None

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return the frequencies of the strongest lines above the band of drifts; none of a record too long."""
        span_s = float(np.ptp(covariates.time_s))
        if covariates.sample_count <= 2 * _LEAST_PERIODS or span_s > _MOST_STEPS * covariates.step_s:
            return []
        start = float(covariates.time_s[0])
        return [{"frequency_hz": frequency, "start_s": start} for frequency in _lines(residuals)]

    def is_same(self, shape: Shape, other: Shape, covariates: Covariates) -> bool:
        """Whether two frequencies lie within the width of a line: a tone that trembles is one."""
        apart = abs(shape["frequency_hz"] - other["frequency_hz"])
        return apart * float(np.ptp(covariates.time_s)) < 4.0

    def sizes(self, covariates: Covariates, fitted: FittedEffect) -> list[Sized]:
        """Return the amplitudes, and that of the harmonics beside that of the line."""
        line, harmonics = (
            norm([value for one in fitted.contributions if one.term == term for value in one.values.values()])
            for term in ("line", "harmonics")
        )
        with np.errstate(over="ignore"):  # beside a line of nothing its harmonics are beyond any limit
            ratio = float(harmonics / np.maximum(line, np.finfo(float).tiny))
        overtones = "harmonics over the line"
        return [*super().sizes(covariates, fitted), Sized(overtones, ratio, self.limits[overtones])]

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return cosine and sine on each row, and those of the second and third harmonic.

        The shape has ``frequency_hz``, hertz, and ``start_s``, the time of phase zero, seconds.
        """
        phase = 2 * np.pi * shape["frequency_hz"] * (covariates.time_s - shape["start_s"])
        terms = []
        for name, orders in (("line", (1,)), ("harmonics", (2, 3))):
            # Rounding leaves nothing of a sine at half the sampling rate, of which no sample shows anything.
            waves = [wave(order * phase).round(9) for order in orders for wave in (np.cos, np.sin)]
            units = {f"{wave} {order}": "T" for order in orders for wave in ("cosine", "sine")}
            terms += course_terms(covariates, name, units, np.column_stack(waves), with_scalar=True)
        return terms


def _lines(residuals: WhitenedResiduals) -> list[float]:
    """Return the frequencies, hertz, at which one row alone has the strongest lines."""
    covariates = residuals.covariates
    information = residuals.row_information * residuals.is_counted[:, None]
    score = residuals.row_shift_T * information
    size = information.sum(axis=0)
    score = score[:, size > 0] / np.sqrt(size[size > 0])
    if not score.shape[1]:
        return []
    time = covariates.time_s - covariates.time_s[0]
    index, spacing = _lattice(time, covariates.step_s)
    length = _FINER * int(index[-1] + 1)
    power = np.zeros(length // 2 + 1)
    row_of = np.zeros(len(power), dtype=int)
    for row, own in enumerate(score.T):
        on_lattice = np.bincount(index, own, minlength=length)
        of_row = np.abs(np.fft.rfft(on_lattice)) ** 2
        row_of[of_row > power] = row
        power = np.maximum(power, of_row)
    frequency = np.arange(len(power)) / (length * spacing)
    # A period that is no minor part of the record is a drift.
    power[(frequency <= _LEAST_PERIODS / time[-1]) | (frequency > (0.5 + NEGLIGIBLE) / covariates.step_s)] = 0
    found: list[float] = []
    while len(found) < 4 and power.max() > 0:
        best = int(power.argmax())
        found.append(_refined(score[:, row_of[best]], time, float(frequency[best]), float(frequency[1])))
        power[max(best - 3 * _FINER, 0) : best + 3 * _FINER + 1] = 0
    return found


def _lattice(time: FloatArray, step: float) -> tuple[FloatArray, float]:
    """Return the place (N,) of each sample on a lattice of times, and its spacing."""
    mean = (time[-1] / max(round(time[-1] / step), 1)) or step
    place = time / mean
    if np.abs(place - np.rint(place)).max() < NEGLIGIBLE:
        return np.rint(place).astype(int), mean
    # Samples that lie on no lattice of their own get four points per step, and at most 16 per sample.
    spacing = max(step / 4, time[-1] / (16 * len(time)))
    return np.rint(time / spacing).astype(int), spacing


def _refined(score: FloatArray, time: FloatArray, frequency: float, width: float) -> float:
    """Return the frequency of the top of a line, by parabolas through the power at three frequencies."""
    for _ in range(3):  # parabolas, each of a quarter of the width
        power = [
            np.abs(np.exp(-2j * np.pi * (frequency + offset) * time) @ score) ** 2 for offset in (-width, 0, width)
        ]
        bend = power[0] - 2 * power[1] + power[2]
        if bend >= 0:
            break
        frequency += width * float(np.clip((power[0] - power[2]) / (2 * bend), -1, 1))
        width /= 4
    return frequency
