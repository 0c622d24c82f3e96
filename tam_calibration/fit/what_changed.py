"""What changed within a recording: sensors or axes that are exchanged, a bias, a gain, or the field of all sensors.

The longer part is calibrated. Each hypothesis says how the readings of the other part would have looked without the
change. The one whose sensors then agree best with each other and with the intensity is named; parameters that it has
free count against it (Schwarz 1978).
"""

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.variance_factors import WHITE
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.change_hypotheses import Hypothesis, PartModel, hypotheses
from tam_calibration.fit.change_within import Span, find_change
from tam_calibration.fit.maximum_likelihood import estimate
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.units import FloatArray

_EXPLAINED = 2.0
"""Largest variance of the residuals under a hypothesis over that of the calibrated part: its directions may differ."""

_LEFT = 1e-3
"""Part of the residuals' energy that a hypothesis may leave in any case: 3 % of their size, which are side effects."""

_LEAST = 50.0
"""Least energy that a hypothesis explains beyond its price where noise is white: chance makes less than its price."""

_BEYOND = 4.0
"""Least ratio of the variances of both parts' residuals where the noise is not white: a room leaves a half or twice."""

_FEW = 3.0
"""Standard errors by which the calibration of all readings may differ from that of the longer part."""

_ROUNDING = 1e-3
"""Least variance of the residuals over that of the noise."""

_PRICE = 3.0
"""Times the price of a free parameter by Schwarz 1978: the calibrated part has errors of its own."""

_WORSE = 16.0
"""Ratio of the residuals' variances from which the shorter part is calibrated: readings that are none fit nothing."""

_LOUD = 100.0
"""Variance of the residuals over that of the calibrated part from which readings fail that nothing explains."""

_NOISE_ALONE = 2.0
"""Variance of the calibrated part's residuals over that of the noise, from which chance is not that of white noise."""


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
        Raw readings, an ambient gradient taken off.
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
    if left < _NOISE_ALONE and calibration.variance_factors == WHITE:
        return calibration
    change = what_changed(recording, array)
    if change is None:
        return calibration
    off = _distance(calibration, recording.take(change.is_calibrated))
    is_wrong = off is None or bool(np.any(np.abs(off) > _FEW * calibration.standard_errors.ravel()))
    if change.is_plain and is_wrong and "residual" not in accept:
        raise Refused(change.sentence)
    calibration = replace(calibration, warnings=(change.sentence, *calibration.warnings))
    if off is None or calibration.covariance is None:
        return calibration
    return replace(calibration, covariance=calibration.covariance + np.outer(off, off))


def _distance(calibration: Calibration, part: SampleSource) -> FloatArray | None:
    """Return by how much errors (12 K,) differ from those of a part of the samples; None where that tells none."""
    if calibration.covariance is None:
        return None
    try:
        alone = estimate(part, calibration.array)
    except (InputError, Refused):
        return None
    return (calibration.errors.to_vector() - alone.to_vector()).ravel()


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
    after, best = parts.best_hypothesis(unchanged_T)
    gained = (before - after) * len(unchanged_T) * parts.model.channels
    if gained < _LEAST if parts.level < _NOISE_ALONE else before < _BEYOND:
        return None
    is_calibrated = span.of_all(parts.is_calibrated, recording.sample_count)
    is_explained = after < max(min(_EXPLAINED, (1 + before) / 2), _LEFT * before)
    if is_explained and (parts.are_steady or after < _EXPLAINED):
        return Change(*_in_words(span, best.words), is_calibrated, span.is_plain)
    if before < _LOUD:
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
        best = int(variances[1] < _WORSE * variances[0]) if all(steady) else steady.index(True)
        model, level = models[best], max(variances[best], _ROUNDING)
        if model is None:
            return None
        other = replace(model, samples=span.some.take(parts[1 - best]))
        is_inside = bool(parts[1 - best][span.first])
        return cls(parts[best], level, other, is_inside, all(steady), max(variances) < _EXPLAINED * level)

    def ratio(self, fields_T: FloatArray) -> float:
        """Return the variance of the other part's residuals over that of the calibrated one's."""
        return self.model.variance(fields_T) / self.level

    def best_hypothesis(self, unchanged_T: FloatArray) -> tuple[float, Hypothesis]:
        """Return the hypothesis that leaves the least ratio, with the price of its free parameters, and that ratio."""
        count = len(unchanged_T) * self.model.channels
        price = _PRICE * np.log(count) / count
        tried = [
            (self.ratio(each.fields_T) + price * each.free, place, each)
            for place, each in enumerate(hypotheses(self.model, unchanged_T, 1 if self.is_inside else -1))
        ]
        after, _, best = min(tried)
        return after, best

    def failing_sensor(self, unchanged_T: FloatArray) -> int:
        """Return the number of the sensor that contradicts the others, where these agree; 0 where they do not."""
        count = unchanged_T.shape[1]
        without = [self.ratio(np.delete(unchanged_T, sensor, axis=1)) for sensor in range(count)] if count > 1 else []
        return int(np.argmin(without)) + 1 if min(without, default=np.inf) < _EXPLAINED else 0


def _in_words(span: Span, words: str) -> tuple[str, str]:
    """Say what is otherwise within a span, and what to do."""
    first, last = _times(span)
    when = f"between {first} and {last} s" if last else f"from {first} s on"
    return f"{words} {when}", f"calibrate the parts apart (--until {first}, --from {last or first})"


def _failing_in_words(span: Span, words: str, is_inside: bool) -> tuple[str, str]:
    """Say what fails within a span, or at all other times, and what to do."""
    first, last = _times(span)
    if is_inside:
        return _in_words(span, words)[
            0
        ], f"leave that time out (--until {first}{f', or --from {last}' if last else ''})"
    when = f"but for the time between {first} and {last} s" if last else f"until {first} s"
    return f"{words} {when}", f"leave that time out (--from {first}{f' --until {last}' if last else ''})"


def _times(span: Span) -> tuple[str, str]:
    """Return in seconds from the first sample when a span begins, and when it ends; empty where it lasts."""
    time_s = span.some.time_s - span.some.time_s[0]
    return f"{time_s[span.first]:.1f}", f"{time_s[span.last]:.1f}" if span.last < len(time_s) else ""
