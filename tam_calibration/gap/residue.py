"""What a recording and its simulated twin leave, sample by sample, for the plots."""

from dataclasses import replace

import numpy as np

from tam_calibration.gap.channels import Channels
from tam_calibration.gap.model import Model
from tam_calibration.gap.result import Residue
from tam_calibration.units import FloatArray


def residue_of(nominal: Model, model: Model, before: Channels, variance: float) -> Residue:
    """Return what each row of each sample is off in front of the causes, with them, and in a twin with noise alone.

    Parameters
    ----------
    nominal, model : Model
        In front of the causes, and with them.
    before : Channels
        Of the nominal model, all samples.
    variance : float
        Of the channels' white noise, in what is stated.
    """
    array = nominal.array
    generator = np.random.default_rng(0)
    situation = before.situation
    scale = float(np.sqrt(variance))
    noise = generator.normal(size=(situation.sample_count, situation.sensor_count, 3)) * (
        scale * nominal.row_noise_T.reshape(-1, 3)
    )
    direction = situation.field_T / situation.intensity_T[:, None]
    field_T: FloatArray = nominal.intensity_T * direction
    scalar = None
    if nominal.recording.scalar_T is not None:
        drawn = generator.normal(size=situation.sample_count) * (scale * (array.scalar_noise_T or 0.0))
        field_T, scalar = situation.field_T, np.where(before.precision > 0, situation.intensity_T + drawn, np.nan)
    readings = situation.errors.distort(field_T) + noise
    twin = Channels.at(
        replace(nominal.recording, readings_T=readings, scalar_T=scalar),
        array,
        nominal.errors,
        nominal.intensity_T,
        world=nominal.world,
    )

    typical = np.array([np.median(row[row > 0]) if row.any() else np.inf for row in before.misfit.row_information.T])

    def shifts(channels: Channels) -> FloatArray:
        information = channels.misfit.row_information
        shift: FloatArray = channels.misfit.row_shift_T * np.sqrt(information / typical)
        shift[information == 0] = np.nan
        return shift

    found, left = shifts(before), shifts(model.base().channels)
    left[~model.is_counted] = np.nan
    return Residue(
        situation.time_s,
        direction,
        found,
        left,
        shifts(twin),
        scale / np.sqrt(typical),
        nominal.recording.temperature_C,
        nominal.recording.current_A,
    )
