"""When the direction of the field departs from the turns that a gyroscope measured.

A magnet that moves on the vehicle, or a wreck that is passed, may change the field of all sensors and of the scalar by
the same amount. Neither their differences nor the intensity show that. A gyroscope does: it measures how the direction
of a uniform field turns in the array.

The mean field of the sensors is fitted with the angular velocity, as if one sensor had read it. Errors of the sensors
and of the gyroscope explain as much of the residual as they can. What they leave is searched for additional fields that
are fixed to the array and begin at some time, at once or gradually.
"""

from typing import NamedTuple

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import ROUNDING, whitening
from tam_calibration.fit.contradiction import SIGNIFICANT
from tam_calibration.fit.gyroscope_check import GyroscopeFit, settled_gyroscope, within_range
from tam_calibration.fit.gyroscope_likelihood import WhiteTurns
from tam_calibration.fit.problem import Known
from tam_calibration.gap.model import Model
from tam_calibration.gap.steps import MOST_CAUSES
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray, origin_of, rounded, to_nanotesla

_LENGTHS = (1, 8, 64, 512)
"""Intervals within which a field begins: at once, as an array swings, as a source is passed, slowly."""

_KNOTS = 32
"""Times at which the information on a field is calculated; between them it is interpolated."""

_MARGIN = 8
"""Intervals at begin and end in which no field begins: too few to tell it from noise."""


def field_direction(model: Model, recording: Recording, array: Array) -> tuple[str, ...]:
    """Return what the gyroscope of a recording says of the direction of the field, in sentences; nothing without one.

    Parameters
    ----------
    model : Model
        With the causes that were found.
    recording : Recording
        That it was fitted to.
    array : Array
        As it was given; the noise of its gyroscope is estimated where it is not stated.
    """
    if recording.angular_velocity_rad_s is None:
        return ()
    field_T = model.base().channels.covariates.field_T
    rates, _ = within_range(recording.angular_velocity_rad_s)
    rates = np.where(model.is_counted[:, None], rates, np.nan)
    seen = Recording(recording.time_s, field_T[:, None], norm(field_T, axis=1), angular_velocity_rad_s=rates)
    noise_T = float(np.sum(model.array.vector_noise_T**-2.0) ** -0.5)
    alone = Array(np.zeros((1, 3)), np.array([noise_T]), model.array.scalar_noise_T, gyroscope=array.gyroscope)
    settled = settled_gyroscope(seen, alone, Known())
    if settled.fit is None:
        return (f"The gyroscope: {settled.reason}.",)
    found = [*settled.notes, *settled.fit.turned]
    remarks = tuple(f"{one[:1].upper()}{one[1:]}." for one in found if one)
    changes = sorted(_changes(settled.fit))
    if not changes:
        return remarks
    words = ", and ".join(_in_words(*change) for change in changes)
    return (
        *remarks,
        f"The direction of the field at all sensors changes while the gyroscope measures no such turn: {words}. "
        "A magnet on the vehicle moved, or a source was passed.",
    )


def _in_words(first_s: float, last_s: float, size_T: float) -> str:
    """Return how large a field is that begins within a span of time, and when."""
    interval = f"at {last_s:.1f} s" if last_s - first_s < 1.0 else f"from {first_s:.1f} to {last_s:.1f} s"
    return f"by {rounded(to_nanotesla(size_T))} nT {interval}"


def _changes(fit: GyroscopeFit) -> list[tuple[float, float, float]]:
    """Return the fields that chance does not make: in which span of time, s, each begins, and its size, tesla."""
    path = fit.likelihood.path
    turns = fit.likelihood.white_turns(*fit.problem.rows_at(fit.place), fit.state)
    count = turns.by_offset.shape[1]
    lengths = [length for length in _LENGTHS if 8 * length < len(turns.links)]
    courses, explained = [], turns.columns[:-1]
    for _ in range(2 * MOST_CAUSES):  # sources that come and go
        basis = explained.T @ whitening(explained @ explained.T, ROUNDING)
        residual = turns.columns[-1] - basis @ (turns.columns[-1] @ basis)
        candidates = (_likeliest(turns, basis, residual, length) for length in lengths)
        likeliest = max(candidates, key=lambda candidate: candidate.chi_square, default=None)
        # Chance makes as much with the probability of χ² with two degrees of freedom.
        if likeliest is None or np.exp(-likeliest.chi_square / 2) * count * len(lengths) >= SIGNIFICANT:
            break
        courses.append(likeliest)
        explained = np.vstack([explained, turns.by_courses(likeliest.course(count)[None])[0]])
    sizes = np.linalg.lstsq(explained.T, turns.columns[-1], rcond=None)[0][len(turns.columns) - 1 :].reshape(-1, 3)
    time_s = path.time_s[:: path.stride] - origin_of(path.time_s[0])
    changes = []
    for one, size in zip(courses, sizes, strict=True):
        last = one.first + one.length - 1
        angle = float(norm(size @ turns.by_offset[:, last]))
        changes.append((float(time_s[one.first - 1]), float(time_s[last]), angle * fit.place.intensity_T))
    return changes


class _Candidate(NamedTuple):
    """A field that grows over so many samples from a first one on; χ² of two components, 1 being that of noise."""

    chi_square: float
    first: int
    length: int

    def course(self, count: int) -> FloatArray:
        """Return its size (count,) over time."""
        return np.clip((np.arange(count) - self.first + 1) / self.length, 0.0, 1.0)


def _likeliest(turns: WhiteTurns, basis: FloatArray, residual: FloatArray, length: int) -> _Candidate:
    """Return the field across that of the world which explains most of a residual (2 L,) and grows in a length.

    Residuals that last are no noise: χ² is counted in units of its median over all times, if that is more than chance.
    """
    steps = np.cumsum(turns.scores(residual)[::-1], axis=0)[::-1]
    summed = np.cumsum(steps, axis=0)
    # At begin and end too few intervals tell a field from noise.
    first = np.arange(turns.links[0] + _MARGIN, turns.links[-1] - _MARGIN - length)
    ramps = (summed[first + length - 1] - summed[first - 1]) / length
    across = turns.by_offset / norm(turns.by_offset, axis=0)
    score = np.sum(np.einsum("nx,xna->na", ramps, across[:, first]) ** 2, axis=1)

    def information_at(some: np.ndarray) -> FloatArray:
        courses = np.array([_Candidate(0.0, one, length).course(len(steps)) for one in some])
        columns = np.einsum("mxr,xma->mar", turns.by_courses(courses), across[:, some])
        left = columns - (columns @ basis) @ basis.T
        return np.asarray(np.mean(np.sum(left**2, axis=2), axis=1))

    knots = first[np.linspace(0, len(first) - 1, _KNOTS).astype(int)]
    information = information_at(knots)
    seen = information > ROUNDING * information.max()
    chi_square = score / np.interp(first, knots[seen], information[seen])
    best = int(np.argmax(chi_square))
    # 2 log 2: the median of χ² with two degrees of freedom.
    unit = max(float(np.median(chi_square)) / (2 * np.log(2)), 1.0)
    exact = float(score[best]) / max(float(information_at(first[[best]])[0]), ROUNDING * float(information.max()))
    return _Candidate(exact / unit, int(first[best]), length)
