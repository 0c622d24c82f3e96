"""The residual of every sample and row before the causes, with them, and of a simulated twin."""

from dataclasses import replace

import numpy as np

from tam_calibration.gap.model import Model
from tam_calibration.gap.result import Residue
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.units import FloatArray


def residue_of(nominal: Model, model: Model, before: WhitenedChannels, variance: float) -> Residue:
    """Return the residual of each row and sample before the causes, with them, and of a twin with noise alone.

    Parameters
    ----------
    nominal, model : Model
        Before the causes, and with them.
    before : WhitenedChannels
        Of the nominal model, all samples.
    variance : float
        Of the channels' white noise, over that of the array.
    """
    array = nominal.array
    generator = np.random.default_rng(0)
    covariates = before.covariates
    scale = float(np.sqrt(variance))
    noise = generator.normal(size=(covariates.sample_count, covariates.sensor_count, 3)) * (
        scale * nominal.row_noise_T.reshape(-1, 3)
    )
    direction = covariates.field_T / covariates.intensity_T[:, None]
    field_T: FloatArray = nominal.intensity_T * direction
    scalar = None
    if nominal.recording.scalar_T is not None:
        drawn = generator.normal(size=covariates.sample_count) * (scale * (array.scalar_noise_T or 0.0))
        field_T, scalar = covariates.field_T, np.where(before.precision > 0, covariates.intensity_T + drawn, np.nan)
    readings = covariates.errors.distort(field_T) + noise
    twin = WhitenedChannels.at(
        replace(nominal.recording, readings_T=readings, scalar_T=scalar),
        array,
        nominal.errors,
        nominal.intensity_T,
        world=nominal.world,
    )

    typical = np.array([np.median(row[row > 0]) if row.any() else np.inf for row in before.residuals.row_information.T])

    def shifts(channels: WhitenedChannels) -> FloatArray:
        information = channels.residuals.row_information
        shift: FloatArray = channels.residuals.row_shift_T * np.sqrt(information / typical)
        shift[information == 0] = np.nan
        return shift

    before_T, after_T = shifts(before), shifts(model.base().channels)
    after_T[~model.is_counted] = np.nan
    return Residue(
        covariates.time_s,
        direction,
        before_T,
        after_T,
        shifts(twin),
        scale / np.sqrt(typical),
        nominal.recording.temperature_C,
        nominal.recording.current_A,
    )
