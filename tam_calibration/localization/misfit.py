"""Whether what a fit leaves of a track is noise: its size, and its colour.

The whitened residuals of a fit that holds all there is are white, of variance one. A source, a bend of the regional
field or a course that is left out stays as something slow. So the residuals of each channel are turned into cosines
over the samples, and the energy of bands of them, each four times as wide as the one before, stands beside that of the
upper half, where only noise is. What the fit itself took out of a band is known: its leverage there.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tam_calibration.model.units import FloatArray

_WIDER = 4
"""Ratio of one band of cosines to the one before."""

CHANCE = 1e-3
"""Probability with which noise alone has a band that stands out."""


@dataclass(frozen=True)
class Misfit:
    """What the residuals of a fit are beside white noise of the stated size.

    Parameters
    ----------
    noise_variance : float
        Of the upper half of the cosines over the stated noise's; 1 where noise alone may well have it.
    colour : float
        The largest variance of a band that noise alone would not have, over that of the upper half; 1 where there is
        none.
    """

    noise_variance: float
    colour: float

    @property
    def variance_factor(self) -> float:
        """By what covariances of the stated noise are to be multiplied: never less than one."""
        return max(self.noise_variance, 1.0) * self.colour


def misfit_of(residuals: FloatArray, slopes: FloatArray, covariance: FloatArray) -> Misfit:
    """Return what residuals are beside white noise.

    Parameters
    ----------
    residuals : (N, D) array
        Whitened, in the order of time.
    slopes : (N, D, P) array
        Derivatives of the whitened data by what was fitted.
    covariance : (P, P) array
        Of the unknowns.
    """
    from scipy.fft import dct
    from scipy.special import chdtr, chdtrc, fdtrc

    energy = np.sum(dct(residuals, axis=0, norm="ortho") ** 2, axis=1)
    waves = dct(slopes, axis=0, norm="ortho")
    freedom = residuals.shape[1] - np.einsum("ndp,pq,ndq->n", waves, covariance, waves, optimize=True)
    half = len(energy) // 2
    most = max(float(freedom[half:].sum()), 1.0)
    variance = float(energy[half:].sum()) / most
    bands = bands_of(half)
    colour = 1.0
    for band in bands:
        own = float(freedom[band].sum())
        if own < 1:
            continue
        ratio = float(energy[band].sum()) / own / variance
        if fdtrc(own, most, ratio) * len(bands) < CHANCE:
            colour = max(colour, ratio)
    chance = 2 * min(chdtr(most, variance * most), chdtrc(most, variance * most))
    return Misfit(variance if chance < CHANCE else 1.0, colour)


def bands_of(count: int) -> list[slice]:
    """Return the bands of the slowest ``count`` cosines, each four times as wide as the one before."""
    edges = [0, *(_WIDER**power for power in range(1, 20) if _WIDER**power < count), count]
    return [slice(low, high) for low, high in pairwise(edges)]
