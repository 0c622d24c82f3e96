"""A source from amplitudes: a fit to all that the sensors read, and whether it explains them.

Three numbers of each sensor and pose are read; a dipole and a line of dipoles take six of all of them, a line of
current five. What is left is compared with the noise and the errors of the calibration. If it is larger, the sensors
may not be exactly where they are stated: their places are then uncertain too, and so is the source. What is more than
that was not made by such a source.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.core.least_squares import Solution
from tam_calibration.fit.contradiction import PLAUSIBLE
from tam_calibration.localization.euler import DIPOLE_INDEX, locate
from tam_calibration.localization.solutions import EulerSolutions, Status
from tam_calibration.localization.source_fit import (
    PLACE_ERROR_M,
    SOURCES,
    fit_fields,
    is_certain,
    start_of,
    unknowns_of,
)
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.demodulation import CHANCE
from tam_calibration.sources.dipole import dipole_field

_MOST_POSES = 100
"""Poses that are fitted together, evenly spaced ones of more: they bound the size of their covariance."""


@dataclass(frozen=True, eq=False)
class Amplitudes:
    """What was read of an alternating source, in one pose or several.

    Parameters
    ----------
    values : (D,) array
        Amplitudes, tesla or T/m.
    noise : (D, D) array
        Covariance of their noise.
    points_m : (P, 3) array
        Where the field is read, metres, in the frame of the source.
    by_points : (D, 3 P) array
        From the stacked fields there to the values.
    by_errors : (D, Q) array
        From errors of the calibration, of standard deviation one, to the values.
    by_places : (P, 3, 3 K) array
        From errors of the sensors' places, array frame, to where the field is read.
    gradient : (P, 3, 3) array
        Of the field there, T/m, as far as it is known without a source.
    to_outputs : (8, D) array
        From the values to field and gradient in the frame of the source.
    """

    values: FloatArray
    noise: FloatArray
    points_m: FloatArray
    by_points: FloatArray
    by_errors: FloatArray
    by_places: FloatArray
    gradient: FloatArray
    to_outputs: FloatArray

    def covariance(self, place_error_m: float = 0.0, gradient: FloatArray | None = None) -> FloatArray:
        """Return the covariance (D, D) of the values about those of the source, whose gradient may be known better."""
        moved = (self.gradient if gradient is None else gradient) @ self.by_places
        places = place_error_m * self.by_points @ moved.reshape(self.by_points.shape[1], -1)
        # Rounding counts as noise: without any the covariance has no inverse.
        rounding = np.finfo(float).eps * np.abs(self.values).max() ** 2 * np.eye(len(self.values))
        return np.asarray(self.noise + self.by_errors @ self.by_errors.T + places @ places.T + rounding)

    def turned(self, matrix: FloatArray, sign: float) -> "Amplitudes":
        """Return the same for a source in a frame to which a rotation (3, 3) leads, the sign of all values changed."""
        by_points = sign * self.by_points.reshape(len(self.values), -1, 3) @ matrix.T
        return replace(
            self,
            points_m=self.points_m @ matrix.T,
            by_places=matrix @ self.by_places,
            gradient=matrix @ self.gradient @ matrix.T,
            by_points=by_points.reshape(self.by_points.shape),
        )

    @classmethod
    def together(cls, parts: Sequence["Amplitudes"]) -> "Amplitudes":
        """Return those of several poses, for sources in one frame."""
        from scipy.linalg import block_diag

        rows = ("values", "points_m", "by_errors", "by_places", "gradient")
        joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in rows}
        noise, by_points = (block_diag(*[getattr(part, name) for part in parts]) for name in ("noise", "by_points"))
        return cls(**joined, noise=noise, by_points=by_points, to_outputs=np.zeros((8, 0)))

    @property
    def outputs(self) -> FloatArray:
        """(8,) field and gradient."""
        return np.asarray(self.to_outputs @ self.values)


@dataclass(frozen=True, eq=False)
class AmplitudeFit:
    """A source that was fitted to amplitudes.

    Parameters
    ----------
    solution : Solution
        Of one problem: place and moment, or nearest point of a line and unit vector along it.
    degrees_of_freedom : int
        What its χ² is expected to be.
    place_error_m : float
        Errors of the sensors' places that its covariance holds, metres; zero where the readings ask for none.
    """

    solution: Solution
    degrees_of_freedom: int
    place_error_m: float

    @property
    def reduced_chi_square(self) -> float:
        """χ² over what it is expected to be."""
        return float(self.solution.chi_square[0]) / self.degrees_of_freedom

    @property
    def chance(self) -> float:
        """Probability with which noise and errors leave more; zero where nothing was found."""
        from scipy.special import chdtrc

        chi_square = float(self.solution.chi_square[0])
        return float(chdtrc(self.degrees_of_freedom, chi_square)) if self.solution.is_found[0] else 0.0

    @property
    def is_explaining(self) -> bool:
        """Whether the source leaves no more than noise and errors."""
        return self.chance >= CHANCE

    @property
    def status(self) -> Status:
        """Whether it locates the source."""
        if not self.is_explaining:
            return Status.MISFIT
        is_sure = is_certain(self.solution.unknowns, self.solution.covariance)[0]
        return Status.LOCATED if is_sure else Status.UNCERTAIN


def fit_amplitudes(amplitudes: Amplitudes, start: FloatArray, index: float) -> AmplitudeFit:
    """Return the source that fits amplitudes, with errors of the places only where it leaves too much without.

    Parameters
    ----------
    amplitudes : Amplitudes
        Of one source.
    start : (6,) array
        Place to begin with [m], and moment [A m²] or a vector along a line, in the frame of the source.
    index : float
        Structural index.
    """
    freedom = len(amplitudes.values) - unknowns_of(index)
    gradient = None
    for place_error_m in (0.0, PLACE_ERROR_M):
        noise = amplitudes.covariance(place_error_m, gradient)
        values, points, by_points = amplitudes.values[None], amplitudes.points_m, amplitudes.by_points
        solution = fit_fields(values, points, by_points, noise, start[None], index)
        fit = AmplitudeFit(solution, freedom, place_error_m)
        # Errors too small to show for sure widen the intervals, and one in twenty sound ones is wider than need be.
        if fit.chance > PLAUSIBLE:
            break
        if index == DIPOLE_INDEX and solution.is_found[0]:
            start = solution.unknowns[0]
            gradient = dipole_field(amplitudes.points_m - start[:3], start[3:])[1]
    return fit


def locate_amplitudes(
    parts: Sequence[Amplitudes], rotation: FloatArray, index: float
) -> tuple[EulerSolutions, AmplitudeFit | None]:
    """Return the source of each pose by itself, and of all of them together.

    Parameters
    ----------
    parts : sequence of Amplitudes
        Of N poses.
    rotation : (N, 3, 3) array
        From the frame of each pose to that in which the source rests.
    index : float
        Structural index.

    Returns
    -------
    solutions : EulerSolutions
        In the frame of each pose.
    together : AmplitudeFit, optional
        In the frame in which the source rests; None where no pose shows where to begin.
    """
    each, own = [], {}
    for number, part in enumerate(parts):
        outputs = part.outputs[None]
        euler = locate(outputs, part.to_outputs @ part.covariance() @ part.to_outputs.T, index=index)
        if euler.is_located[0]:
            fit = own[number] = fit_amplitudes(part, start_of(euler, index)[0], index)
            located = fit.solution.take(np.array([fit.status == Status.LOCATED]))
            euler = EulerSolutions.of_fits(np.array([fit.status]), located, index == DIPOLE_INDEX)
        each.append(euler)
    return EulerSolutions.joined(each), _together(parts, rotation, own, index) if own else None


def _together(
    parts: Sequence[Amplitudes], rotation: FloatArray, own: dict[int, AmplitudeFit], index: float
) -> AmplitudeFit:
    """Return the source of the poses that have a fit of their own, which begins with the best of these."""
    if len(parts) == 1:
        return own[0]
    best = min(own, key=lambda number: own[number].reduced_chi_square)
    start = np.concatenate([rotation[best] @ half for half in np.split(own[best].solution.unknowns[0], 2)])
    seen = np.array(sorted(own))[np.linspace(0, len(own) - 1, min(len(own), _MOST_POSES)).round().astype(int)]
    fields = [rotation[number] @ parts[number].outputs[:3] for number in seen]
    both = [
        parts[number].turned(rotation[number], 1.0 if field @ rotation[best] @ parts[best].outputs[:3] > 0 else -1.0)
        for number, field in zip(seen, fields, strict=True)
    ]
    return fit_amplitudes(Amplitudes.together(both), start, index)


def require_one_source(fits: Mapping[float, AmplitudeFit | None], index: float) -> None:
    """Refuse amplitudes that one source does not explain, or that a line explains as well as a dipole.

    Parameters
    ----------
    fits : mapping
        From each structural index to the fit of all amplitudes.
    index : float
        The structural index that is asked for.

    Raises
    ------
    Refused
        With what the source may be instead.
    """
    fit = fits[index]
    assert fit is not None
    rivals = [
        other
        for other, one in fits.items()
        if other != index and one is not None and one.is_explaining and one.place_error_m <= fit.place_error_m
    ]
    names = " or ".join(f"{SOURCES[other]} (structural index {other:g})" for other in rivals)
    if not fit.is_explaining:
        mend = (
            f"They are those of a {names}"
            if rivals
            else "There are two sources, or one that is large for its distance, or the calibration does not hold any "
            "more"
        )
        raise Refused(
            f"the amplitudes are not those of one {SOURCES[index]}: what is left is "
            f"{np.sqrt(fit.reduced_chi_square):.3g} times what noise, the calibration and places of the sensors to "
            f"{1e3 * PLACE_ERROR_M:g} mm leave. {mend}"
        )
    if index == DIPOLE_INDEX and rivals:
        raise Refused(
            f"a {names} explains the amplitudes as well as a {SOURCES[index]}, and is elsewhere: state its index if it "
            "is one; else go nearer, or to where the moment is not at right angles to the line of sight"
        )
