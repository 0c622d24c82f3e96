"""Effects of an axis' own field: a reading that is a curve of it, or depends on where it came from."""

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.polynomial.legendre import legvander

from tam_calibration.effects.covariates import Memory, follow
from tam_calibration.effects.effect import Coefficient, Covariates, LinearEffect, Shape, Term, WhitenedResiduals
from tam_calibration.effects.grades import MINOR
from tam_calibration.effects.laws import angles_of, axis_at, order_terms
from tam_calibration.model.units import FloatArray

_ORDERS = {"quadratic": (2,), "cubic": (3,), "higher": (4, 5), "highest": (6, 7, 8, 9)}
"""Orders of the polynomials that stand or fall together, by name: bends, and kinks as of a limit that is soft."""


class Nonlinearity(LinearEffect):
    """The reading of an axis is a curve of the field along it."""

    name = "nonlinearity"

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that no axis was turned far enough, where it is so."""
        spread = float(np.ptp(covariates.sensed_T, axis=0).max() / covariates.intensity_T.max())
        if spread < MINOR:
            return f"no axis sees the field change by more than {100 * spread:.2g} % of its length"
        return None

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return the largest field as the full scale.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        residuals : WhitenedResiduals
            Not used: the full scale follows from the field.
        """
        return ({"full_scale_T": full_scale(covariates)},)

    def terms(self, covariates: Covariates, shape: Shape) -> Iterator[Term]:
        """Yield Legendre polynomials of degree 2 to 9 of the field along each axis.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        shape : Shape
            ``full_scale_T``, the field that the polynomials are scaled by, tesla.
        """
        for row in range(covariates.scalar_row):
            curves = legvander(covariates.sensed_T[:, row] / shape["full_scale_T"], 9)
            yield from order_terms(covariates, row, _ORDERS, "P", curves)


def full_scale(covariates: Covariates) -> float:
    """Return the largest field along any axis, tesla."""
    return float(np.abs(covariates.sensed_T).max())


_PLAYS = (0.15, 0.4)
"""Fields that must be turned back before a sharp loop closes, as parts of the full scale: narrow and wide."""

_ROUNDED = (0.1, 0.5)
"""Fields over which a rounded loop closes, as parts of the full scale."""

# A curve alone is no loop: it is offered with those that it closes at the ends of the range.
_LOOPS = {
    "loop": [Coefficient(f"play {width}", "1") for width in _PLAYS],
    "rounded loop": [Coefficient(f"width {width}", "1") for width in _ROUNDED],
    "saturating loop": [
        Coefficient(name, "T")
        for name in ("P2", "P3", *(f"P{order} of play {width}" for width in _PLAYS for order in (3, 5)))
    ],
}

_DIRECTIONS = np.array(
    [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, -1, 0), (1, 0, 1), (1, 0, -1), (0, 1, 1), (0, 1, -1),
     (1, 1, 1), (1, 1, -1), (1, -1, 1), (1, -1, -1)]
)  # fmt: skip
"""Directions along which soft iron beside a sensor may be magnetised, to start from."""


class Hysteresis(LinearEffect):
    """The reading follows the field in loops of several widths, without depending on the rate."""

    name = "hysteresis"

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that the field was not turned back along any axis, where it was not."""
        size = full_scale(covariates)
        width = MINOR * size / 2
        state = play(covariates.sensed_T, np.array([width]))[:, :, 0]
        movement = np.diff(state, axis=0)
        if not ((movement > 0).any(axis=0) & (movement < 0).any(axis=0)).any():
            return "the field along no axis was turned up and back down"
        return None

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return the largest field as the full scale, alone and with directions of soft iron.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        residuals : WhitenedResiduals
            Not used: the directions are fixed.
        """
        scale = {"full_scale_T": full_scale(covariates)}
        return [scale, *({**scale, **angles} for angles in angles_of(_DIRECTIONS))]

    def terms(self, covariates: Covariates, shape: Shape) -> Iterator[Term]:
        """Yield loops of each axis in its own field, or in the field along a direction of the array.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        shape : Shape
            ``full_scale_T``, tesla; for soft iron its direction too: ``azimuth_rad``, ``elevation_rad``, array frame.
        """
        scale = shape["full_scale_T"]
        drives = covariates.sensed_T
        if "azimuth_rad" in shape:
            drives = covariates.field_T @ axis_at(shape)[:, None]
        # Less than a per cent of the full scale counts as noise, which must not erase the memory.
        states = play(drives, scale * np.array([0.01, *_PLAYS]), covariates.memory)
        rounded = [rounded_loop(states[:, :, 0], scale * width, covariates.memory) for width in _ROUNDED]
        for row in range(covariates.scalar_row):
            if row < drives.shape[1]:
                drive, plays = drives[:, [row]], states[:, row, 1:]
                curve = legvander(drive[:, 0] / scale, 3)[:, 2:]
                bent = legvander(plays / scale, 5)[:, :, [3, 5]].reshape(len(drive), -1)
                loops = plays - drive, np.hstack([loop[:, [row]] for loop in rounded]), np.hstack([curve, bent])
            for (name, parts), features in zip(_LOOPS.items(), loops, strict=True):
                yield Term.of_row(covariates, row, name, parts, features)


def rounded_loop(drive: FloatArray, width: float, memory: Memory | None = None) -> FloatArray:
    """Return x (N, R) of dx = ds - |ds| x / width for drives s (N, R), from rest at zero (Dahl's model of friction).

    Parameters
    ----------
    drive : (N, R) array
        Field that drives each of R loops, tesla.
    width : float
        Path of the drive over which a loop settles, tesla.
    memory : Memory, optional
        State after the previous batch of samples; by default the loops start from rest.
    """
    before = None if memory is None else memory.recall()
    path, state = (drive[:1], np.zeros(drive.shape[1])) if before is None else before
    change = np.diff(np.concatenate([path, drive]), axis=0)
    limit = width * np.sign(change)
    loop = follow(limit, limit, state, np.abs(change) / width)[1:]
    if memory is not None:
        memory.keep((drive[-1:], loop[-1]))
    return loop


def play(drive: FloatArray, widths: FloatArray, memory: Memory | None = None) -> FloatArray:
    """Return the states (N, R, W) of play operators of half-widths (W,) that drives (N, R) push.

    They start from rest at zero, or from where they stood in their memory.

    p_n = min(s_n + w, max(s_n - w, p_{n-1})). Such steps in a row are one step of the same kind, so that blocks of
    samples are worked through side by side: first from the extremes, which tells what each makes of any state before,
    then what all blocks up to each make of the first, by doubling their reach.

    Parameters
    ----------
    drive : (N, R) array
        Field that pushes the operators, tesla.
    widths : (W,) array
        Half-widths w, tesla.
    memory : Memory, optional
        State after the previous batch of samples; by default the operators start from rest.
    """
    count = len(drive)
    length = max(int(np.cbrt(count)), 1)
    padded = np.concatenate([drive, np.repeat(drive[-1:], -count % length, axis=0)])
    blocks = padded.reshape(-1, length, drive.shape[1], 1)

    def pushed(state: FloatArray, step: int) -> FloatArray:
        now = blocks[:, step]
        return np.minimum(now + widths, np.maximum(now - widths, state))

    shape = (len(blocks), drive.shape[1], len(widths))
    low, high = np.full(shape, -np.inf), np.full(shape, np.inf)
    for step in range(length):
        low, high = pushed(low, step), pushed(high, step)
    reach = 1
    while reach < len(blocks):
        last = low[reach:].copy(), high[reach:].copy()
        low[reach:], high[reach:] = (np.clip(own[:-reach], *last) for own in (low, high))
        reach *= 2
    before = None if memory is None else memory.recall()
    first = np.zeros(shape[1:]) if before is None else before
    state: FloatArray = np.concatenate([first[None], np.clip(first, low[:-1], high[:-1])])
    states = np.empty((len(blocks), length, *shape[1:]))
    for step in range(length):
        state = pushed(state, step)
        states[:, step] = state
    if memory is not None:
        memory.keep(state[-1])
    return states.reshape(-1, *shape[1:])[:count]
