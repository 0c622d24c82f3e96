"""How a form stands among its surrogates."""

from dataclasses import dataclass

import numpy as np

from tam_calibration.units import FloatArray


@dataclass(frozen=True)
class Standing:
    """How a form stands among its surrogates.

    Parameters
    ----------
    gain : float
        Twice the logarithm of its likelihood ratio.
    largest : float
        The same of the best surrogate; zero where there is none.
    rank : float
        Part of the surrogates, itself among them, that explain as much.
    """

    gain: float
    largest: float
    rank: float

    @classmethod
    def among(cls, gain: float, others: FloatArray) -> "Standing":
        """Return the standing of a gain among others (S,)."""
        largest = float(np.max(others, initial=0.0))
        return cls(gain, largest, float(1 + np.sum(others >= gain)) / (1 + len(others)))

    @property
    def ratio(self) -> float:
        """How many times the best surrogate's gain."""
        return self.gain / max(self.largest, 1.0)
