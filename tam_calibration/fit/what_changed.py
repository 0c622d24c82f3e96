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
from tam_calibration.fit.change_hypotheses import PartModel, hypotheses
from tam_calibration.fit.change_within import Span, find_change
from tam_calibration.fit.maximum_likelihood import estimate
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.units import FloatArray

_EXPLAINED = 4.0
"""Largest variance of the residuals under a hypothesis over that of the calibrated part: its directions may differ."""

_LEFT = 1e-3
"""Part of the residuals' energy that a hypothesis may leave in any case: 3 % of their size, which are side effects."""

_LEAST = 50.0
"""Least energy that a hypothesis explains beyond its price where noise is white: chance makes less than its price."""

_FEW = 3.0
"""Standard errors by which the calibration of all readings may differ from that of the longer part."""

_ROUNDING = 1e-3
"""Least variance of the residuals over that of the noise."""

_LARGE = 3.0
"""Change of a reading, over its noise, from which a recording is refused: smaller ones widen the standard errors."""

_PRICE = 3.0
"""Times the price of a free parameter by Schwarz 1978: the calibrated part has errors of its own."""

_WORSE = 16.0
"""Ratio of the residuals' variances from which the shorter part is calibrated: readings that are none fit nothing."""

_LOUD = 100.0
"""Variance of the residuals over that of the calibrated part from which readings fail that follow no calibration."""

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
    is_large : bool
        Whether readings change by more than three times their noise.
    is_explained : bool
        Whether both parts are calibrations: no sensor fails in one of them.
    """

    what: str
    todo: str
    is_calibrated: NDArray[np.bool_]
    is_large: bool = True
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
        When readings change by more than three times their noise, and the calibration is more than three standard
        errors from that of the longer part.
    """
    left = max(calibration.reduced_chi_square.values(), default=1.0)
    if left < _NOISE_ALONE and calibration.variance_factors == WHITE:
        return calibration
    change = what_changed(recording, array)
    if change is None:
        return calibration
    off = _distance(calibration, recording.take(change.is_calibrated))
    is_wrong = off is None or bool(np.any(np.abs(off) > _FEW * calibration.standard_errors.ravel()))
    if change.is_large and is_wrong and "residual" not in accept:
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
    if span is None:
        return None
    parts = sorted((span.is_inside, ~span.is_inside), key=np.mean)
    models = [PartModel.of(span.some.take(part), span.array) for part in parts]
    variances = [model.variance(model.fields(model.samples.readings_T)) if model else np.inf for model in models]
    steady = [span.inside_is_steady if part[span.first] else span.outside_is_steady for part in parts]
    calibrated = int(variances[1] < _WORSE * variances[0]) if all(steady) else steady.index(True)
    model = models[calibrated]
    if model is None:
        return None
    level, is_inside = max(variances[calibrated], _ROUNDING), bool(parts[1 - calibrated][span.first])
    other = replace(model, samples=span.some.take(parts[1 - calibrated]))
    unchanged_T = other.fields(other.samples.readings_T)
    before, count = other.variance(unchanged_T) / level, len(unchanged_T) * other.channels
    tried = [
        (other.variance(each.fields_T) / level + _PRICE * each.free * np.log(count) / count, place, each)
        for place, each in enumerate(hypotheses(other, unchanged_T, 1 if is_inside else -1))
    ]
    after, _, best = min(tried)
    if count * (before - after) < _LEAST if level < _NOISE_ALONE else before < _EXPLAINED:
        return None
    is_calibrated = span.of_all(parts[calibrated], recording.sample_count)
    if all(steady) and after < max(min(_EXPLAINED, (1 + before) / 2), _LEFT * before):
        size_T = np.sqrt(np.mean(np.sum((best.fields_T - unchanged_T) ** 2, axis=2), axis=0)).max()
        noise_T = np.sqrt(max(level, 1.0)) * span.array.vector_noise_T.max()
        return Change(*_in_words(span, best.words), is_calibrated, bool(size_T > _LARGE * noise_T))
    if words := _unexplained(other, unchanged_T, level) if before > _LOUD else "":
        return Change(*_failing_in_words(span, words, is_inside), is_calibrated, is_explained=False)
    if all(steady) and max(variances) < _EXPLAINED * level and before > _EXPLAINED:
        return Change(*_in_words(span, "the readings follow another calibration"), is_calibrated)
    return None


def _in_words(span: Span, words: str) -> tuple[str, str]:
    """Say what is otherwise within a span, and what to do."""
    first, last = _times(span)
    when = f"from {first} s on" if last is None else f"between {first} and {last} s"
    return f"{words} {when}", f"calibrate the parts apart (--until {first}, --from {last or first})"


def _failing_in_words(span: Span, words: str, is_inside: bool) -> tuple[str, str]:
    """Say what fails within a span, or at all other times, and what to do."""
    first, last = _times(span)
    if is_inside:
        when = f"from {first} s on" if last is None else f"between {first} and {last} s"
        return f"{words} {when}", f"leave that time out (--until {first}{f', or --from {last}' if last else ''})"
    when = f"until {first} s" if last is None else f"but for the time between {first} and {last} s"
    return f"{words} {when}", f"leave that time out (--from {first}{f' --until {last}' if last else ''})"


def _times(span: Span) -> tuple[str, str | None]:
    """Return in seconds from the first sample when a span begins, and when it ends unless it lasts."""
    time_s = span.some.time_s - span.some.time_s[0]
    return f"{time_s[span.first]:.1f}", f"{time_s[span.last]:.1f}" if span.last < len(time_s) else None


def _unexplained(model: PartModel, unchanged_T: FloatArray, level: float) -> str:
    """Say which sensor contradicts the others, or that none does, where no hypothesis explains how."""
    count = unchanged_T.shape[1]
    without = [model.variance(np.delete(unchanged_T, sensor, axis=1)) for sensor in range(count if count > 1 else 0)]
    if without and min(without) < _EXPLAINED * level:
        return f"sensor {int(np.argmin(without)) + 1} contradicts the others"
    mean_T = unchanged_T.mean(axis=1, keepdims=True)
    between = np.mean((unchanged_T - mean_T) ** 2) / np.mean(model.array.vector_noise_T**2)
    if count > 1 and between < _EXPLAINED * level:
        return "all sensors feel something magnetic alike"
    return ""
