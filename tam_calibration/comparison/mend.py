"""What a simulation lacks: the effects and the noise to add to it."""

from dataclasses import dataclass, fields

from tam_calibration.correction.calibration import Calibration
from tam_calibration.gap.noise import AxisNoise
from tam_calibration.model.fitted_effect import FittedEffect


@dataclass(frozen=True)
class NoiseTerm:
    """Noise of one axis that a simulation shall have, and what has to be added to what it has now.

    Parameters
    ----------
    sensor : int
        Number 1…K; 0 for the scalar.
    axis : str
        "x", "y", "z"; empty for the scalar.
    white_T : float
        Standard deviation of the white noise that it shall have.
    added_white_T : float
        Standard deviation of the white noise that is missing; 0 where it has too much.
    knee_hz, exponent : float
        Of the slow noise that it shall have and has not, in addition to the white noise ``white_T``; NaN without one.
    band_hz : (float, float), optional
        Of the band of noise that it shall have and has not.
    band_T : float
        Standard deviation in the band.
    """

    sensor: int
    axis: str
    white_T: float
    added_white_T: float
    knee_hz: float = float("nan")
    exponent: float = float("nan")
    band_hz: tuple[float, float] | None = None
    band_T: float = 0.0

    @classmethod
    def of(cls, noise: AxisNoise) -> "NoiseTerm":
        """Return all the noise of an axis as noise to add."""
        return cls(**{each.name: getattr(noise, each.name.removeprefix("added_")) for each in fields(cls)})


@dataclass(frozen=True, eq=False)
class Mend:
    """What to write into the simulator.

    Parameters
    ----------
    added : tuple of FittedEffect
        Effects that the simulation lacks, in the order of their sizes; their times are since the first sample of a run.
    removed : tuple of str
        Effects that it should not have, or have with the parameters of ``added``.
    noise : tuple of NoiseTerm
        Of every axis and the scalar.
    calibration : Calibration
        Of the recording: array, errors of the sensors, noise and all its effects.
    rate_hz : float
        Of the recording's samples.
    """

    added: tuple[FittedEffect, ...]
    removed: tuple[str, ...]
    noise: tuple[NoiseTerm, ...]
    calibration: Calibration
    rate_hz: float
