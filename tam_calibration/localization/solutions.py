"""Where the sources of many samples are, why some could not be located, and what a recording tells of its source.

Generic tools show a position and a moment with their covariances as poses and ellipsoids.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import partial

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import Solution
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.demodulation import CHANCE, Spectrum

ELLIPSOID_PROBABILITY = 0.95
"""With which a source is within its ellipsoid: what is usual for maps."""


class Status(IntEnum):
    """Whether a sample was located, and if not, why."""

    LOCATED = 0
    NOT_FINITE = 1
    NO_FIELD = 2
    NO_GRADIENT = 3
    ILL_CONDITIONED = 4
    AMBIGUOUS = 5
    UNCERTAIN = 6
    NO_ATTITUDE = 7
    NO_REGIONAL = 8
    APART = 9
    MISFIT = 10

    @property
    def reason(self) -> str:
        """Why, and what would mend it; empty where it was located."""
        return _REASONS[self]


_REASONS = {
    Status.LOCATED: "",
    Status.NOT_FINITE: "field or tensor is not finite: the array's geometry must determine a gradient, "
    "and the sensors that do so be there",
    Status.NO_FIELD: "the field of the source is zero or within its noise: go nearer, or average longer",
    Status.NO_GRADIENT: "the gradient tensor is zero or within its noise: go nearer, or average longer",
    Status.ILL_CONDITIONED: "the smallest eigenvalue of the tensor is zero or within its noise, as it is where the "
    "moment is at right angles to the line of sight: use the constrained solution",
    Status.AMBIGUOUS: "two places explain the sample as well, as where the two smallest eigenvalues of the tensor "
    "are equal within their noise: go nearer, average longer, state the regional field, or it is no single dipole",
    Status.UNCERTAIN: "the position is too uncertain for its distance: go nearer, average longer, or measure the "
    "attitude better",
    Status.NO_ATTITUDE: "the attitude is unknown, without which the regional field cannot be taken off, nor a position "
    "be turned into the world",
    Status.NO_REGIONAL: "the regional field is not known yet: it is fitted to the first samples",
    Status.APART: "by itself it gives another place than all samples of the run together: it has several solutions; go "
    "nearer, or average longer",
    Status.MISFIT: "one source leaves more than noise and the calibration's errors: switch off a second one, state "
    "another structural index, go farther from a large one, or calibrate the array anew",
}


@dataclass(frozen=True, eq=False)
class EulerSolutions:
    """Where the source of each of N samples is.

    Parameters
    ----------
    position_m : (N, 3) array
        Of the source in the array frame, metres; NaN where it was not located.
    position_covariance_m2 : (N, 3, 3) array
        To first order in the covariance of the outputs; NaN where that was not given.
    moment_Am2 : (N, 3) array
        Magnetic moment of a dipole there, A m²; NaN for other structural indices.
    moment_covariance_A2m4 : (N, 3, 3) array
        Likewise.
    status : (N,) array of int
        A ``Status`` for each sample.
    chi_square : (N,) array, optional
        Squares that the source leaves of the outputs over their covariance: NaN where nothing was fitted.
    along : (N, 3) array, optional
        Unit vector along a line, either way, in the array frame; NaN for dipoles.
    """

    position_m: FloatArray
    position_covariance_m2: FloatArray
    moment_Am2: FloatArray
    moment_covariance_A2m4: FloatArray
    status: np.ndarray
    chi_square: FloatArray = field(default_factory=partial(np.empty, 0))
    along: FloatArray = field(default_factory=partial(np.empty, 0))

    def __post_init__(self) -> None:
        """Fill in what is not known."""
        for name, shape in (("chi_square", ()), ("along", (3,))):
            if not getattr(self, name).size:
                object.__setattr__(self, name, np.full((len(self.status), *shape), np.nan))

    @classmethod
    def refused(cls, count: int, status: Status) -> "EulerSolutions":
        """Return those of samples that are all refused for one reason.

        Parameters
        ----------
        count : int
            Number of samples.
        status : Status
            The reason.
        """
        vectors, matrices = np.full((2, count, 3), np.nan), np.full((2, count, 3, 3), np.nan)
        return cls(vectors[0], matrices[0], vectors[1], matrices[1], np.full(count, status, dtype=int))

    @classmethod
    def of_fits(cls, status: np.ndarray, solution: Solution, is_dipole: bool) -> "EulerSolutions":
        """Return those of N samples, of which M were located.

        Parameters
        ----------
        status : (N,) array of int
            A ``Status`` for each sample; M of them are ``LOCATED``.
        solution : Solution
            Of these: place, and the moment of a dipole or the direction of a line, (M, 6).
        is_dipole : bool
            Whether the sources are dipoles.
        """
        at = status == Status.LOCATED
        result = cls.refused(len(status), Status.UNCERTAIN)
        result.status[:], result.chi_square[at] = status, solution.chi_square
        result.position_m[at], vectors = np.split(solution.unknowns, 2, axis=1)
        result.position_covariance_m2[at] = solution.covariance[:, :3, :3]
        if is_dipole:
            result.moment_Am2[at], result.moment_covariance_A2m4[at] = vectors, solution.covariance[:, 3:, 3:]
        else:
            result.along[at] = vectors
        return result

    @classmethod
    def joined(cls, parts: Sequence["EulerSolutions"]) -> "EulerSolutions":
        """Return those of all samples of some parts, one after the other."""
        return cls(**{name: np.concatenate([vars(part)[name] for part in parts]) for name in vars(parts[0])})

    def without_covariance(self) -> "EulerSolutions":
        """Return the same where the noise of the outputs is not known."""
        names = ("position_covariance_m2", "moment_covariance_A2m4", "chi_square")
        return replace(self, **{name: np.full_like(getattr(self, name), np.nan) for name in names})

    def misfits(self, freedom: int) -> np.ndarray:
        """Return the located samples (n,) of which the source leaves more than noise and errors with a χ² so free."""
        from scipy.special import chdtrc

        return np.flatnonzero(self.is_located & (chdtrc(freedom, self.chi_square) < CHANCE))

    def put(self, at: np.ndarray, others: "EulerSolutions") -> "EulerSolutions":
        """Return the same with other solutions for some samples."""
        copied = {name: value.copy() for name, value in vars(self).items()}
        for name, value in copied.items():
            value[at] = getattr(others, name)
        return EulerSolutions(**copied)

    def tested(self, freedom: int) -> "EulerSolutions":
        """Return the same with ``MISFIT`` for all misfits."""
        at = self.misfits(freedom)
        return self.put(at, EulerSolutions.refused(len(at), Status.MISFIT)) if len(at) else self

    def take(self, at: np.ndarray) -> "EulerSolutions":
        """Return those of some samples."""
        return EulerSolutions(**{name: value[at] for name, value in vars(self).items()})

    @property
    def is_located(self) -> np.ndarray:
        """(N,) whether each sample was located."""
        return np.asarray(self.status == Status.LOCATED)

    @property
    def distance_m(self) -> FloatArray:
        """(N,) distances of the sources from the array's centre, metres."""
        return np.asarray(norm(self.position_m, axis=1))


def ellipsoid(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the ellipsoid that holds a normally distributed position with ``ELLIPSOID_PROBABILITY``.

    Parameters
    ----------
    covariance : (3, 3) array
        Of the position, m².

    Returns
    -------
    semi_axes : (3,) array
        Rising, metres.
    rotation : (4,) array
        Quaternion x, y, z, w that turns the axes x, y and z to the semi-axes.
    """
    from scipy.spatial.transform import Rotation
    from scipy.special import chdtri

    variances, vectors = np.linalg.eigh(covariance)
    vectors[:, 2] *= np.sign(np.linalg.det(vectors))  # else it would be a reflection
    semi_axes: FloatArray = np.sqrt(chdtri(3, 1 - ELLIPSOID_PROBABILITY) * np.maximum(variances, 0.0))
    return semi_axes, Rotation.from_matrix(vectors).as_quat()


def pose_rows(solutions: EulerSolutions) -> FloatArray:
    """Return sources as the numbers of ``geometry_msgs/PoseWithCovariance``.

    The pose's axis x points along the moment; any angle about it is as good as another. Where there is no moment any
    orientation is. Between position and orientation the covariance is zero: it is not worked out.

    Parameters
    ----------
    solutions : EulerSolutions
        Of N samples.

    Returns
    -------
    (N, 43) array
        Position in metres, quaternion x, y, z, w, and the (6, 6) covariance of position and rotations about the fixed
        axes x, y and z, row by row, m² and rad².
    """
    count = len(solutions.status)
    covariance = np.zeros((count, 6, 6))
    covariance[:, :3, :3] = solutions.position_covariance_m2
    any_angle = np.pi**2 / 3  # variance, rad², of an angle that is anything from -π to π
    covariance[:, 3:, 3:] = any_angle * np.eye(3)
    rotation = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    length = np.linalg.norm(solutions.moment_Am2, axis=1)
    known = np.flatnonzero(length > 0)
    unit = solutions.moment_Am2[known] / length[known, None]
    rotation[known] = _from_x_to(unit)
    across = np.cross(unit[:, None], np.eye(3)).transpose(0, 2, 1) / length[known, None, None]
    tilt = across @ solutions.moment_covariance_A2m4[known] @ across.transpose(0, 2, 1)
    covariance[known, 3:, 3:] = tilt + any_angle * unit[:, :, None] * unit[:, None]
    return np.hstack([solutions.position_m, rotation, covariance.reshape(count, 36)])


def _from_x_to(unit: FloatArray) -> FloatArray:
    """Return the quaternions (n, 4) of the shortest rotations from the axis x to unit vectors (n, 3)."""
    x, y, z = unit.T
    quaternion = np.column_stack([np.zeros_like(x), -z, y, 1 + x])
    length = np.linalg.norm(quaternion, axis=1, keepdims=True)
    backward = np.array([0.0, 0.0, 1.0, 0.0])
    return np.where(length > 1e-6, quaternion / np.maximum(length, 1e-6), backward)


ARRAY_FRAME = "array frame: x forward, y left, z up, from the array's centre"
WORLD_FRAME = "axes of the attitude's world, from the array's centre"


@dataclass(frozen=True, eq=False)
class Overall:
    """One source for all samples.

    Parameters
    ----------
    position_m, moment_Am2 : (3,) array
        Metres, A m²; of an alternating source peak values, whose sign is open.
    position_covariance_m2, moment_covariance_A2m4 : (3, 3) array
        Theirs.
    chi_square : float
        Sum of the squared residuals over the noise.
    degrees_of_freedom : int
        What it is expected to be.
    """

    position_m: FloatArray
    position_covariance_m2: FloatArray
    moment_Am2: FloatArray
    moment_covariance_A2m4: FloatArray
    chi_square: float
    degrees_of_freedom: int


@dataclass(frozen=True, eq=False)
class Line:
    """The frequency of an alternating source.

    Parameters
    ----------
    frequency_hz : float
        At which it was demodulated.
    standard_error_hz : float
        NaN where it was stated.
    spectrum : Spectrum, optional
        Of all readings, where a line stands out of it.
    """

    frequency_hz: float
    standard_error_hz: float
    spectrum: Spectrum | None


@dataclass(frozen=True, eq=False)
class Survey:
    """The sources of N samples of a steady field, or of N poses in an alternating one.

    Parameters
    ----------
    frame : str
        Of all positions and moments, in words.
    time_s : (N,) array
        Of the samples, or the middles of the poses, seconds.
    solutions : EulerSolutions
        The source of each.
    overall : Overall, optional
        The source of all together, where the places of the array are known.
    regional_T : (3,) array, optional
        Field that was taken off, in the world, tesla.
    line : Line, optional
        Of an alternating source.
    note : str
        What else is to be known, one sentence or nothing.

    Raises
    ------
    Refused
        When not one sample was located.

    Examples
    --------
    >>> import numpy as np
    >>> from tam_calibration.localization.solutions import EulerSolutions, Status
    >>> from tam_calibration.localization.solutions import ARRAY_FRAME, Survey
    >>> place_m, moment_Am2 = np.array([[3.0, 1.0, -2.0]]), np.array([[0.0, 0.0, 50.0]])
    >>> covariance = 0.01 * np.eye(3)[None]
    >>> solutions = EulerSolutions(place_m, covariance, moment_Am2, covariance, np.array([Status.LOCATED]))
    >>> survey = Survey(ARRAY_FRAME, np.array([0.0]), solutions)
    >>> survey.position_standard_errors_m
    array([[0.1, 0.1, 0.1]])
    """

    frame: str
    time_s: FloatArray
    solutions: EulerSolutions
    overall: Overall | None = None
    regional_T: FloatArray | None = None
    line: Line | None = None
    note: str = ""

    def __post_init__(self) -> None:
        """Check that there is something to tell."""
        if self.overall is None and not self.solutions.is_located.any():
            count = len(self.time_s)
            worst, times = self.refusals.most_common(1)[0]
            seen = "the sample" if count == 1 else f"{times} of {count} samples"
            raise Refused(f"no source can be located; in {seen} {worst.reason}")

    @property
    def refusals(self) -> Counter[Status]:
        """How many samples were refused, by their reason."""
        return Counter(Status(int(status)) for status in self.solutions.status if status != Status.LOCATED)

    @property
    def position_standard_errors_m(self) -> FloatArray:
        """(N, 3) standard errors of the positions, metres."""
        return standard_errors(self.solutions.position_covariance_m2)


def standard_errors(covariance: FloatArray) -> FloatArray:
    """Return the square roots (…, D) of the diagonals of covariances (…, D, D)."""
    return np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
