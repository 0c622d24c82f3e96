"""Samples as they arrive, without what the effects of a calibration add to them."""

from dataclasses import replace

import numpy as np

from tam_calibration.correction.calibration import Calibration
from tam_calibration.effects.removal import EffectStream, linear_effect, of_array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording


class Unaffected:
    """Takes the effects that go with the array off batches of samples, in the order of time.

    Parameters
    ----------
    calibration : Calibration
        With effects or without.

    Raises
    ------
    InputError
        When an effect can only be taken off a whole recording.
    """

    def __init__(self, calibration: Calibration) -> None:
        effects = of_array(calibration.effects)
        if late := [fitted.effect for fitted in effects if not linear_effect(fitted).is_causal]:
            raise InputError(
                f"the calibration has the effect {late[0]}, which needs later samples to be taken off: "
                "use a calibration without it"
            )
        self._stream = EffectStream(effects, calibration.errors, calibration.array) if effects else None

    def of(self, recording: Recording) -> Recording:
        """Return the samples without the effects; those whose channels do not tell them are left out."""
        if self._stream is None:
            return recording
        added = self._stream.added(recording)
        readings = recording.readings_T - added.rows_T[:, :-1].reshape(recording.readings_T.shape)
        scalar = None if recording.scalar_T is None else recording.scalar_T - added.rows_T[:, -1]
        return replace(recording, readings_T=readings, scalar_T=scalar).take(np.asarray(added.is_known.all(axis=1)))
