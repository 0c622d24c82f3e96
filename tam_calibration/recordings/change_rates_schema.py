"""How array and calibration files state how fast the errors of sensors change: with the unit in each key."""

from collections.abc import Callable
from dataclasses import fields
from typing import Annotated

import numpy as np

from tam_calibration.files.schema import Bounds, Document
from tam_calibration.files.text_files import degrees_to_write, nanotesla_to_write, ppm_to_write
from tam_calibration.model.change_rates import ChangeRates
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla

_Rate = Annotated[float, Bounds(least=0)]


class RatesFile(Document):
    """The keys of ``change_rates``; a rate that is not stated is that of ``ChangeRates``."""

    scale_factor_ppm_per_day: _Rate | None = None
    scale_factor_ppm_per_K: _Rate | None = None
    non_orthogonality_deg_per_day: _Rate | None = None
    non_orthogonality_deg_per_K: _Rate | None = None
    bias_nT_per_day: _Rate | None = None
    bias_nT_per_K: _Rate | None = None
    misalignment_deg_per_day: _Rate | None = None
    misalignment_deg_per_K: _Rate | None = None

    def to_rates(self) -> ChangeRates:
        """Return the rates in SI.

        Raises
        ------
        InputError
            When one is beyond what a working sensor does.
        """
        stated = {each.name: value for each in fields(self) if (value := getattr(self, each.name)) is not None}
        rates = {}
        for kind, (unit, _, to_si) in _UNITS.items():
            for per in ("day", "K"):
                if (key := f"{kind}_{unit}_per_{per}") in stated:
                    rates[f"{kind}_per_{per}"] = to_si(stated[key])
        return ChangeRates(**rates)


_UNITS: dict[str, tuple[str, Callable[[FloatArray], FloatArray], Callable[[float], float]]] = {
    "scale_factor": ("ppm", ppm_to_write, lambda ppm: ppm / 1e6),
    "non_orthogonality": ("deg", degrees_to_write, from_degrees),
    "bias": ("nT", nanotesla_to_write, from_nanotesla),
    "misalignment": ("deg", degrees_to_write, from_degrees),
}
"""Unit of each kind in files, and the conversions to it and back."""


def rates_to_mapping(rates: ChangeRates) -> dict[str, float]:
    """Return the keys and values of rates in a file."""
    return {
        f"{kind}_{unit}_per_{per}": float(to_write(np.array(getattr(rates, f"{kind}_per_{per}"))))
        for kind, (unit, to_write, _) in _UNITS.items()
        for per in ("day", "K")
    }
