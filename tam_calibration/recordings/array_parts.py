"""Parts of array files: tolerances, change rates and gyroscope, with the unit in each key."""

from dataclasses import astuple, fields
from typing import Annotated, Any

from tam_calibration.files.quantities import block_to_write, in_si
from tam_calibration.files.schema import Bounds, Document
from tam_calibration.model.data_sheet import ChangeRates, Gyroscope, Tolerances

_Rate = Annotated[float, Bounds(least=0)]


class TolerancesFile(Document):
    """The keys of ``tolerances``; all of them are needed."""

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
        return Tolerances(*in_si(self))


class GyroscopeFile(Document):
    """The keys of ``gyroscope``; noise that is left out is estimated, and a bias that is left out is that of a chip.

    Parameters
    ----------
    noise_mdps_per_sqrt_Hz : float, optional
        One-sided density of the noise, as data sheets state it.
    bias_deg_per_s : float, optional
        Standard deviation of a constant bias of each axis about zero.
    scale_error_percent : float
        Standard deviation of the scale of each axis, and of the angles between axes; 0 by default.
    """

    noise_mdps_per_sqrt_Hz: float | None = None
    bias_deg_per_s: float | None = None
    scale_error_percent: float = 0.0

    def to_gyroscope(self) -> Gyroscope:
        """Return the gyroscope in SI.

        Raises
        ------
        InputError
            When a value is not positive, or no gyroscope has it.
        """
        stated = zip(fields(Gyroscope), in_si(self), strict=True)
        return Gyroscope(**{each.name: value for each, value in stated if value is not None})


class RatesFile(Document):
    """The keys of ``change_rates``, in the order of `ChangeRates`; a rate that is not stated is the default there."""

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
        stated = zip(fields(ChangeRates), in_si(self), strict=True)
        return ChangeRates(**{each.name: value for each, value in stated if value is not None})


_SCHEMAS: dict[type, type[Document]] = {
    Tolerances: TolerancesFile,
    Gyroscope: GyroscopeFile,
    ChangeRates: RatesFile,
}


def part_to_mapping(part: Tolerances | Gyroscope | ChangeRates | None) -> dict[str, Any] | None:
    """Return keys and values of a part of an array file; None of no part."""
    return None if part is None else block_to_write(_SCHEMAS[type(part)], astuple(part))
