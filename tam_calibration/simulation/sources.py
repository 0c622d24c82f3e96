"""Where the field comes from: the site's uniform field and its drift, in the world's east, north, up.

A magnetic object near it is a ``sources.dipole.Dipole``.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.linalg import norm

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray


def field_from_elements(intensity_T: float, inclination: float, declination: float) -> FloatArray:
    """Return the (3,) field east, north, up, tesla.

    Parameters
    ----------
    intensity_T : float
        Of the field, tesla.
    inclination : float
        Radians, positive downwards.
    declination : float
        Radians, positive to the east.
    """
    north = np.cos(inclination) * np.cos(declination)
    east = np.cos(inclination) * np.sin(declination)
    return intensity_T * np.array([east, north, -np.sin(inclination)])


class Drift(Protocol):
    """How the uniform field of the site changes with time."""

    def variation_T(self, time_s: FloatArray, site_field_T: FloatArray) -> FloatArray:
        """Return what is added to the field of the site, (N, 3) east, north, up, tesla.

        Parameters
        ----------
        time_s : (N,) array
            Times of the samples, seconds.
        site_field_T : (3,) array
            Uniform field of the site, east, north, up, tesla.
        """


@dataclass(frozen=True)
class SinusoidDrift:
    """An intensity that swings as a sinusoid about the site's.

    Parameters
    ----------
    standard_deviation_T : float
        Of the intensity over the samples, tesla.
    period_s : float
        Duration of one swing, seconds.
    """

    standard_deviation_T: float
    period_s: float

    def variation_T(self, time_s: FloatArray, site_field_T: FloatArray) -> FloatArray:
        """Return what is added to the field of the site, (N, 3) east, north, up, tesla.

        Parameters
        ----------
        time_s : (N,) array
            Times of the samples, seconds.
        site_field_T : (3,) array
            Uniform field of the site, along which it swings, tesla.
        """
        return _along(site_field_T, np.sin(2 * np.pi * time_s / self.period_s), self.standard_deviation_T)


@dataclass(frozen=True)
class RampDrift:
    """An intensity that rises steadily about the site's.

    Parameters
    ----------
    standard_deviation_T : float
        Of the intensity over the samples, tesla.
    """

    standard_deviation_T: float

    def variation_T(self, time_s: FloatArray, site_field_T: FloatArray) -> FloatArray:
        """Return what is added to the field of the site, (N, 3) east, north, up, tesla.

        Parameters
        ----------
        time_s : (N,) array
            Times of the samples, seconds.
        site_field_T : (3,) array
            Uniform field of the site, along which it rises, tesla.
        """
        return _along(site_field_T, time_s, self.standard_deviation_T)


@dataclass(frozen=True, eq=False)
class ObservedDrift:
    """The variation that an observatory recorded about its mean, turned from its magnetic meridian into the site's.

    Parameters
    ----------
    time_s : (M,) array
        Times of the record, increasing; 0 is the start of the simulation.
    field_T : (M, 3) array
        Components to magnetic north, magnetic east and down, tesla; NaN where the record has a gap.
    """

    time_s: FloatArray
    field_T: FloatArray

    def variation_T(self, time_s: FloatArray, site_field_T: FloatArray) -> FloatArray:
        """Return what is added to the field of the site, (N, 3) east, north, up, tesla.

        Parameters
        ----------
        time_s : (N,) array
            Times of the samples, seconds.
        site_field_T : (3,) array
            Uniform field of the site, east, north, up, tesla; its level part gives the magnetic meridian.

        Raises
        ------
        InputError
            When the record has a gap in the time of the simulation, or does not span it.
        """
        columns = [np.interp(time_s, self.time_s, column, left=np.nan, right=np.nan) for column in self.field_T.T]
        north, east, down = np.array(columns) - np.mean(columns, axis=1, keepdims=True)
        if not np.isfinite(north + east + down).all():
            span = time_s[-1] - time_s[0]
            raise InputError(
                f"the observatory's record has a gap within the {span:.0f} s of the simulation, or does not span them: "
                "choose another start or fewer samples"
            )
        meridian = np.arctan2(site_field_T[0], site_field_T[1])
        cosine, sine = np.cos(meridian), np.sin(meridian)
        return np.stack([north * sine + east * cosine, north * cosine - east * sine, -down], axis=1)


def _along(site_field_T: FloatArray, shape: FloatArray, standard_deviation_T: float) -> FloatArray:
    """Return the (N, 3) variation along the site field that has the shape (N,) and exactly the standard deviation."""
    if np.ptp(shape) == 0:
        raise InputError("one sample cannot drift: ask for more samples or for no drift")
    intensity = standard_deviation_T * (shape - shape.mean()) / shape.std()
    return np.outer(intensity, site_field_T / norm(site_field_T))
