"""How an array file states the tolerances of its sensors: with the unit in each key."""

from dataclasses import dataclass

import numpy as np

from tam_calibration.files.text_files import degrees_to_write, nanotesla_to_write, percent_to_write
from tam_calibration.model.tolerances import Tolerances
from tam_calibration.model.units import from_degrees, from_nanotesla


@dataclass(frozen=True, kw_only=True)
class TolerancesFile:
    """The keys of ``tolerances``, all of which are needed: what is left out would be known, or be anything."""

    scale_factor_percent: float
    non_orthogonality_deg: float
    bias_nT: float
    misalignment_deg: float

    def to_tolerances(self) -> Tolerances:
        """Return the tolerances in SI.

        Raises
        ------
        InputError
            When one is not positive, or beyond what a working sensor has.
        """
        return Tolerances(
            self.scale_factor_percent / 100,
            from_degrees(self.non_orthogonality_deg),
            from_nanotesla(self.bias_nT),
            from_degrees(self.misalignment_deg),
        )


def tolerances_to_mapping(tolerances: Tolerances) -> dict[str, float]:
    """Return the keys and values of tolerances in a file."""
    written = {
        "scale_factor_percent": percent_to_write(np.array(tolerances.scale_factor)),
        "non_orthogonality_deg": degrees_to_write(np.array(tolerances.non_orthogonality)),
        "bias_nT": nanotesla_to_write(np.array(tolerances.bias_T)),
        "misalignment_deg": degrees_to_write(np.array(tolerances.misalignment)),
    }
    return {key: float(value) for key, value in written.items()}
