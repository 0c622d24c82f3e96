"""A fit of joined samples, which keeps what became of the messages that they come from."""

from collections.abc import Callable
from dataclasses import replace

from tam_calibration.correction.calibration import Calibration
from tam_calibration.messages.usage import Usage
from tam_calibration.model.recording import SampleSource


def fit_with_usage(
    samples: SampleSource, usage: Usage | None, fit: Callable[[SampleSource], Calibration]
) -> Calibration:
    """Return the calibration of samples, with what became of the messages that they come from.

    Parameters
    ----------
    samples : SampleSource
        With each reading once.
    usage : Usage or None
        Of the messages; None where nothing was joined and nothing is missing.
    fit : callable
        From samples to a calibration.

    Raises
    ------
    InputError, Refused
        Where less than half of the messages were used, before the fit, and as the fit.
    """
    if usage is None:
        return fit(samples)
    usage.require_enough()
    calibration = fit(samples)
    warnings = (*usage.warnings(), *usage.interpolation_warnings(samples, calibration.array.vector_noise_T))
    notes = (*usage.missing, *calibration.notes)
    return replace(calibration, warnings=(*warnings, *calibration.warnings), notes=notes)
