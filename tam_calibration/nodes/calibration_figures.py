"""How good a calibration is, in one line for people and in figures for /diagnostics."""

from tam_calibration.correction.calibration import Calibration

_DAY_S = 86_400.0
_OLDEST_S = 20 * 365 * _DAY_S


def introduce(calibration: Calibration | None, path: str, now_s: float) -> str:
    """Return the calibration that a node starts with, and its age; or where there is none yet.

    Parameters
    ----------
    calibration : Calibration or None
        That was loaded.
    path : str
        Where from; empty where no file is named.
    now_s : float
        Time of the node's clock, seconds.
    """
    if calibration is None:
        return f"no calibration: {path} is not there yet" if path else "no calibration"
    return f"calibration {path}, {_tell_age(_age_s(calibration, now_s))}: {calibration.quality}"


def figures(calibration: Calibration | None, now_s: float) -> dict[str, object]:
    """Return the figures of a calibration for /diagnostics (SI); nothing where there is none.

    Parameters
    ----------
    calibration : Calibration or None
        The one in use.
    now_s : float
        Present time on the clock of the recording's stamps, seconds; the age counts from the recording's end.
    """
    if calibration is None:
        return {"calibration": "none"}
    best, floor, age_s = calibration.best_residuals, calibration.floor, _age_s(calibration, now_s)
    return {
        "calibration": calibration.method,
        "quality": calibration.quality.grade,
        "calibration_samples": calibration.samples,
        "calibration_age_s": "unknown" if age_s is None else f"{age_s:.0f}",
        "tensor_residual_T_per_m": f"{best.tensor_rmse_T_per_m:.4g}",
        "tensor_floor_T_per_m": f"{floor.tensor_rmse_T_per_m:.4g}",
        "intensity_residual_T": f"{best.sensors_rms_T:.4g}",
        "intensity_floor_T": f"{floor.sensors_rms_T:.4g}",
    }


def _age_s(calibration: Calibration, now_s: float) -> float | None:
    """Return the time since the recording ended; None where its stamps are of another clock."""
    age = now_s - calibration.time_span_s[1]
    return age if 0 <= age < _OLDEST_S else None


def _tell_age(age_s: float | None) -> str:
    if age_s is None:
        return "of unknown age"
    return f"{age_s / 3600:.1f} h old" if age_s < 2 * _DAY_S else f"{age_s / _DAY_S:.0f} days old"
