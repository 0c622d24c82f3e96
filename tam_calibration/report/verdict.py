"""Whether a calibration can be used, and why it should be doubted."""

from dataclasses import dataclass

import numpy as np

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.coverage import Coverage
from tam_calibration.model.residuals import Residuals
from tam_calibration.model.units import to_nanotesla
from tam_calibration.report.formatting import join, number, ratio, sentence

_ACCEPTED_RATIO = 1.1
"""Largest residual over noise floor of a calibration that is not doubted, apart from chance."""

_ACCEPTED_GROWTH = np.sqrt(2)
"""Largest standard error of a corrected sample over what sensor noise alone makes: both have an equal part in it."""


@dataclass(frozen=True)
class Doubt:
    """A reason to doubt a calibration in a few words, and in full with its figures and what would mend it."""

    reason: str
    detail: str


@dataclass(frozen=True)
class Verdict:
    """A judgement.

    Parameters
    ----------
    sentence : str
        The whole judgement in one sentence.
    doubts : tuple of Doubt
        What speaks against the calibration; empty when it can be used.
    limits : tuple of str
        What the calibration does not claim, however good it is.
    """

    sentence: str
    doubts: tuple[Doubt, ...]
    limits: tuple[str, ...]


def judge(calibration: Calibration, coverage: Coverage) -> Verdict:
    """Judge whether a calibration can be used.

    Parameters
    ----------
    calibration : Calibration
        Its residuals are held against the noise floor, its standard errors against what sensor noise alone makes; its
        warnings are doubts too.
    coverage : Coverage
        Field directions in the array frame that its recording visited.
    """
    reasons = (
        _doubt_residuals(calibration),
        # What a prior tells need not be visited again: the standard errors say whether both are enough.
        None if calibration.update else _doubt_coverage(coverage),
        _doubt_standard_errors(calibration),
        _doubt_fit(calibration),
    )
    doubts = tuple(doubt for doubt in reasons if doubt)
    return Verdict(f"{_headline(calibration)}; {_conclusion(calibration, doubts)}.", doubts, _limits(calibration))


def best_evidence(calibration: Calibration) -> Residuals:
    """Return the residuals to judge by: of held-out samples where there are any."""
    return calibration.held_out or calibration.in_sample


def _headline(calibration: Calibration) -> str:
    has_gradient = calibration.array.has_gradient
    name, unit = ("Tensor error", "nT/m") if has_gradient else ("|B| error", "nT")
    residuals = (calibration.before, best_evidence(calibration), calibration.floor)
    before, after, floor = (
        to_nanotesla(each.tensor_rmse_T_per_m if has_gradient else float(np.sqrt(np.mean(each.sensor_intensity_T**2))))
        for each in residuals
    )
    verb = "falls" if after < before else "rises"
    origin = ", which was estimated from the same recording" if calibration.noise_is_estimated else ""
    change = f"{name} {verb} from {number(before)} to {number(after)} {unit}"
    return f"{change}, {ratio(after / floor)} × the noise floor{origin}"


def _conclusion(calibration: Calibration, doubts: tuple[Doubt, ...]) -> str:
    if doubts:
        return f"the calibration should be doubted: {join([doubt.reason for doubt in doubts])}"
    if calibration.has_scalar_reference:
        return "the calibration can be used"
    return "the calibration can be used but for its absolute scale, which no scalar reference fixes"


def _doubt_residuals(calibration: Calibration) -> Doubt | None:
    """Compare with the floor, leaving room for three standard deviations of an RMS of so many samples."""
    accepted = _ACCEPTED_RATIO + 3 / np.sqrt(2 * calibration.samples)
    residuals, floor = best_evidence(calibration), calibration.floor
    sensors = residuals.sensor_intensity_T / floor.sensor_intensity_T
    ratios = {f"|B| of sensor {sensor + 1}": float(value) for sensor, value in enumerate(sensors)}
    if calibration.array.has_gradient:
        ratios["the tensor"] = residuals.tensor_rmse_T_per_m / floor.tensor_rmse_T_per_m
    high = [f"{name} ({ratio(value)} ×)" for name, value in ratios.items() if not value <= accepted]
    if not high:
        return None
    detail = (
        f"Above {ratio(accepted)} × the noise floor: {join(high)}. More than sensor noise is left: the field changed "
        "or was not uniform, a disturbance was on board, or the noise is larger than stated."
    )
    return Doubt("its residual is above the noise floor", detail)


def _doubt_coverage(coverage: Coverage) -> Doubt | None:
    if coverage.enough:
        return None
    seen = f"The field visited {100 * coverage.fraction:.0f} % of the sphere of directions"
    missing = f", missing most {coverage.missing}" if coverage.missing else ""
    return Doubt("its coverage of the sphere is too low", f"{seen}{missing}. {sentence(coverage.advice)}")


def _doubt_standard_errors(calibration: Calibration) -> Doubt | None:
    """Compare the standard error of corrected samples, all directions alike, with what sensor noise alone makes."""
    noise = np.sqrt(calibration.correction_matrix**2 @ np.repeat(calibration.array.vector_noise_T**2, 3))
    growth = float(np.nanmax(calibration.output_standard_errors / noise))
    if growth <= _ACCEPTED_GROWTH:
        return None
    detail = (
        "Over all directions of the field, the parameters' uncertainty makes the standard error of a corrected sample "
        f"up to {ratio(growth)} × what sensor noise alone makes. A longer recording in more directions would mend it."
    )
    return Doubt("its standard errors are large", detail)


def _doubt_fit(calibration: Calibration) -> Doubt | None:
    if not calibration.warnings:
        return None
    return Doubt("the fit warns of a flaw", sentence(f"The fit warns: {'; '.join(calibration.warnings)}"))


def _limits(calibration: Calibration) -> tuple[str, ...]:
    limits = []
    if not calibration.has_scalar_reference:
        limits.append("There was no scalar reference: the absolute scale is unknown, and |B| is taken as constant.")
    if calibration.covariance is None:
        limits.append("The method gives no covariance: the standard errors of the parameters are unknown.")
    if calibration.held_out is None:
        limits.append("No samples were held out: the residuals are those of the samples that were fitted.")
    if calibration.noise_is_estimated:
        limits.append(
            "Not every noise was stated: the noise floor was estimated from this recording, and a residual near it "
            "proves less. State the noise in the array file to judge by it."
        )
    return tuple(limits)
