"""Effects of the field itself: a reading that is a curve of it, or depends on where it came from or its direction."""

from collections.abc import Iterable, Iterator
from itertools import product

import numpy as np
from numpy.polynomial.legendre import legvander

from tam_calibration.core.harmonics import harmonics
from tam_calibration.effects.effect import Coefficient, Covariates, LinearEffect, Shape, Term, WhitenedResiduals
from tam_calibration.effects.grades import MINOR, MOST, SLIGHT
from tam_calibration.effects.recursions import play, rounded_loop
from tam_calibration.effects.term import angles_of, axis_at, order_terms, scalar_term

_ORDERS = {"quadratic": [2], "cubic": [3], "higher": [4, 5], "highest": [6, 7, 8, 9]}
"""Orders of the polynomials that stand or fall together, by name: bends, and kinks as of a limit that is soft."""


class Nonlinearity(LinearEffect):
    """The reading of an axis is a curve of the field along it."""

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that no axis was turned far enough, where it is so."""
        spread = float(np.ptp(covariates.sensed_T, axis=0).max() / covariates.intensity_T.max())
        told = f"no axis sees the field change by more than {100 * spread:.2g} % of its length"
        return told if spread < MINOR else None

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return the largest field as the full scale."""
        return ({"full_scale_T": full_scale(covariates)},)

    def terms(self, covariates: Covariates, shape: Shape) -> Iterator[Term]:
        """Yield Legendre polynomials of degree 2 to 9 of the field along each axis.

        The shape has ``full_scale_T``, the field that the polynomials are scaled by, tesla.
        """
        for row in range(covariates.scalar_row):
            curves = legvander(covariates.sensed_T[:, row] / shape["full_scale_T"], 9)
            yield from order_terms(covariates, row, _ORDERS, "P", curves)


def full_scale(covariates: Covariates) -> float:
    """Return the largest field along any axis, tesla."""
    return float(np.abs(covariates.sensed_T).max())


_PLAYS = (0.15, 0.4)
"""Fields that must be turned back before a sharp loop closes, as parts of the full scale: narrow and wide."""

_ROUNDED = MINOR, MOST
"""Fields over which a rounded loop closes, as parts of the full scale."""

# A curve alone is no loop: it is offered with those that it closes at the ends of the range.
_LOOPS = {
    "loop": [Coefficient(f"play {width}", "1") for width in _PLAYS],
    "rounded loop": [Coefficient(f"width {width}", "1") for width in _ROUNDED],
    "saturating loop": [
        Coefficient(name, "T")
        for name in ("P2", "P3", *(f"{curve} of play {width}" for width in _PLAYS for curve in ("P3", "P5")))
    ],
}


class Hysteresis(LinearEffect):
    """The reading follows the field in loops of several widths, without depending on the rate."""

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that the field was not turned back along any axis, where it was not."""
        width = MINOR * full_scale(covariates) / 2
        state = play(covariates.sensed_T, np.array([width]))[:, :, 0]
        movement = np.diff(state, axis=0)
        if not ((movement > 0).any(axis=0) & (movement < 0).any(axis=0)).any():
            return "the field along no axis was turned up and back down"
        return None

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return the largest field as the full scale, alone and with directions of soft iron.

        They are those of the faces, edges and corners of a cube; opposite ones are the same.
        """
        directions = np.array(list(product((1, 0, -1), repeat=3))[:13])
        scale = {"full_scale_T": full_scale(covariates)}
        return [scale, *({**scale, **angles} for angles in angles_of(directions))]

    def terms(self, covariates: Covariates, shape: Shape) -> Iterator[Term]:
        """Yield loops of each axis in its own field, or in the field along a direction of the array.

        The shape has ``full_scale_T``, tesla, and for soft iron its direction: ``azimuth_rad``, ``elevation_rad``.
        """
        scale = shape["full_scale_T"]
        drives = covariates.field_T @ axis_at(shape)[:, None] if "azimuth_rad" in shape else covariates.sensed_T
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


_AXIS_ORDERS = ([3], [4], [5, 6], [7, 8], [9, 10], [11, 12])
"""Of the polynomials about one axis that stand or fall together; dead zones are sharp."""


class ScalarHeadingError(LinearEffect):
    """The scalar reading is off by a function of the direction of the field in the array frame.

    Up to the second degree such a function is inside the calibration; what can be seen begins with the third.
    """

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that the directions are too few to tell a third degree from a calibration error, where they are."""
        functions = harmonics(covariates.direction, 3)
        scatter = functions.T @ functions
        # A calibration error makes any of the nine harmonics up to degree 2: they are eliminated.
        own, both, others = scatter[:9, :9], scatter[9:, :9], scatter[9:, 9:]
        left = others - both @ np.linalg.pinv(own, rcond=1e-9, hermitian=True) @ both.T
        is_hidden = np.trace(left) < SLIGHT**2 * np.trace(others)
        return "the field does not come from enough directions" if is_hidden else None

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return any function of the direction, and functions of the angle to 96 axes, fourteen degrees apart.

        They lie evenly over half the sphere: opposite axes have the same polynomials but for signs.
        """
        index = np.arange(96)
        z, azimuth = 1 - (index + 0.5) / 96, np.pi * (1 + np.sqrt(5)) * index
        flat = np.sqrt(1 - z**2)
        return [{}, *angles_of(np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), z]))]

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return spherical harmonics of degrees 3 to 6, or Legendre polynomials about an axis of degrees 3 to 12.

        The shape is empty, or has ``azimuth_rad`` and ``elevation_rad`` of an axis in the array frame.
        """
        direction = covariates.direction
        if "azimuth_rad" in shape:
            curves = legvander(np.clip(direction @ axis_at(shape), -1, 1), _AXIS_ORDERS[-1][-1])
            groups = {f"about an axis, degree {orders[0]}": orders for orders in _AXIS_ORDERS}
            return order_terms(covariates, covariates.scalar_row, groups, "P", curves)
        functions, terms = harmonics(direction, 6), []
        for degree in (3, 4, 5, 6):
            units = {f"degree {degree}, order {order}": "T" for order in range(-degree, degree + 1)}
            own = functions[:, degree**2 : (degree + 1) ** 2]
            terms.append(scalar_term(covariates, f"degree {degree}", units, own))
        return terms
