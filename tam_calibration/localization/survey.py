"""What a recording tells of the source in it."""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from tam_calibration.localization.solutions import EulerSolutions, Status
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.demodulation import Spectrum

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
    center_m : (N, 3) array
        Places of the array's centre, metres.
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
    >>> from tam_calibration.localization.survey import ARRAY_FRAME, Survey
    >>> place_m, moment_Am2 = np.array([[3.0, 1.0, -2.0]]), np.array([[0.0, 0.0, 50.0]])
    >>> covariance = 0.01 * np.eye(3)[None]
    >>> solutions = EulerSolutions(place_m, covariance, moment_Am2, covariance, np.array([Status.LOCATED]))
    >>> survey = Survey(ARRAY_FRAME, np.array([0.0]), solutions, center_m=np.zeros((1, 3)))
    >>> survey.position_standard_errors_m
    array([[0.1, 0.1, 0.1]])
    """

    frame: str
    time_s: FloatArray
    solutions: EulerSolutions
    center_m: FloatArray
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
