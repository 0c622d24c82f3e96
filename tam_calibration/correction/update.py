"""What a calibration took from the one before it: the shares of data and prior, and what has moved in between."""

from dataclasses import dataclass

from tam_calibration.model.change_rates import ChangeRates
from tam_calibration.model.units import FloatArray

KINDS = ("scale factor", "non-orthogonality", "bias", "misalignment")
"""Of the errors of a sensor: three of the twelve each, in their order."""

SEVERAL, ALL_BIASES, COMMON_SCALE = "several errors", "biases", "scalar reading, or the scale factors"
"""What changes together: all errors of a sensor, the biases of all, and what is common to the scale of all."""


def in_words(kind: str, sensor: int) -> str:
    """Return what a change is of, for a sentence; sensor 0 is all of them."""
    return f"{kind} of {f'sensor {sensor}' if sensor else 'all sensors'}"


@dataclass(frozen=True, eq=False)
class Moved:
    """A change that a prior and its rates do not explain.

    Parameters
    ----------
    kind : str
        One of ``KINDS``.
    sensor : int
        From 1.
    change, standard_errors : (3,) array
        What the errors of the kind are now less what they were, SI.
    probability : float
        Of this change among those of one kind of one sensor, each as likely before.
    rivals : tuple of (str, int)
        Kind and sensor of others that are not improbable; a kind may be one of what changes together, sensor 0 is all.
    since_s : float, optional
        When, on the clock of the recording, where it shows that; None where it was so from its start.
    together : (str, int), optional
        Kind and sensor of what changed together, where this is a part of it.
    """

    kind: str
    sensor: int
    change: FloatArray
    standard_errors: FloatArray
    probability: float
    rivals: tuple[tuple[str, int], ...] = ()
    since_s: float | None = None
    together: tuple[str, int] | None = None


@dataclass(frozen=True, eq=False)
class Update:
    """How a calibration came from an older one and a recording.

    Parameters
    ----------
    prior : str
        Which calibration was the prior: its recording or its method.
    rates : ChangeRates, optional
        By which it was widened; None for tolerances of new sensors, which no time widens.
    elapsed_s, warming_K : float, optional
        Time and temperature since; None where unknown.
    prior_standard_errors : (K, 12) array
        Before the recording, SI.
    data_share : (K, 12) array
        Part of the information on each parameter that the recording gave: one less the ratio of the variances after and
        before; NaN for what is fixed.
    chi_square : float
        Of the difference between prior and data.
    freedom : int
        Number of independent directions that it counts.
    probability : float
        Of one as large where nothing moved beyond the rates.
    moved : tuple of Moved
        What the data contradict the prior in, the most certain first; the prior counts little there.
    """

    prior: str
    rates: ChangeRates | None
    elapsed_s: float | None
    warming_K: float | None
    prior_standard_errors: FloatArray
    data_share: FloatArray
    chi_square: float
    freedom: int
    probability: float
    moved: tuple[Moved, ...] = ()

    @property
    def prior_in_words(self) -> str:
        """What the prior was, for a sentence."""
        return "the tolerances of the array file" if self.rates is None else "the prior"
