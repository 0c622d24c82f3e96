"""Correcting samples as they arrive, in batches of any size, with what is known of them."""

from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.correction.calibration import Calibration, Corrected, without_rows
from tam_calibration.correction.partial import ContradictionSearch, PartialCorrection
from tam_calibration.effects.effect import LinearEffect
from tam_calibration.effects.library import effect_named
from tam_calibration.effects.removal import EffectStream, linear_effect, removable
from tam_calibration.model.further_channels import channel_in_words
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class CorrectedBatch:
    """The results of a batch of samples.

    Parameters
    ----------
    outputs : (N, 9) array
        As in ``Corrected``.
    standard_errors : (N, 9) array
        Of each; an effect that could not be taken off counts with its size over the recording of the calibration.
    left_in : tuple of str
        Names of the effects that could not be taken off some of the samples.
    scalar_T : (N,) array, optional
        The scalar's readings without the effects, tesla; None where there are none.
    """

    outputs: FloatArray
    standard_errors: FloatArray
    left_in: tuple[str, ...]
    scalar_T: FloatArray | None = None


def correct(recording: Recording, calibration: Calibration) -> Corrected:
    """Return the calibrated field at the array's centre and the magnetic gradient tensor of raw readings.

    Samples of which one sensor contradicts all others are corrected with these; ``remarks`` of the result says so.

    Parameters
    ----------
    recording : Recording
        Readings (N, K, 3), tesla, of the array that was calibrated.
    calibration : Calibration
        Whose errors and effects are taken off.

    Returns
    -------
    Corrected
        (N, 9) outputs in the array frame, tesla and T/m, and the standard error of each column.

    Raises
    ------
    InputError
        When the recording has another number of sensors or lacks a channel that an effect needs, or its readings are
        not geomagnetic in tesla.

    Examples
    --------
    >>> from tam_calibration import calibrate, correct, read_scenario, simulate
    >>> made = simulate(read_scenario("wu_table_1"))
    >>> corrected = correct(made.recording, calibrate(made.recording, made.scenario.array))
    >>> corrected.outputs.shape  # bx by bz [T], gxx gxy gxz gyy gyz gzz [T/m]
    (360, 9)
    >>> (corrected.standard_errors[:3] * 1e9).round(1)  # nT: 1 nT of noise in each of four sensors
    array([0.5, 0.5, 0.5])
    """
    corrected, failing = calibration.correct(recording), ContradictionSearch(calibration)
    codes = failing.codes_of(recording.time_s, recording.readings_T)
    if not codes.any():
        return corrected
    return replace(PartialCorrection(calibration).correct(recording, codes), remarks=tuple(failing.sentences()))


class Correction:
    """Corrects the samples of one run in the order of time; the same as ``Calibration.correct`` of all of them.

    An effect stays in samples whose channels it needs are silent, and in all where it needs samples that are still
    to come: the standard errors then say so.

    Parameters
    ----------
    calibration : Calibration
        Whose effects are taken off.

    Attributes
    ----------
    takes_off : tuple of str
        Names of the effects that go with the array.
    """

    def __init__(self, calibration: Calibration) -> None:
        self._calibration, self.partial = calibration, PartialCorrection(calibration)
        self.contradiction = ContradictionSearch(calibration)
        sizes = zip(calibration.effects, calibration.effect_sizes, strict=True)
        removed = {id(fitted) for fitted in removable(calibration.effects) if not linear_effect(fitted).is_of_site}
        kept = [(fitted, size.rms) for fitted, size in sizes if id(fitted) in removed]
        kept.sort(key=lambda one: not linear_effect(one[0]).is_causal)
        live = [fitted for fitted, _ in kept if linear_effect(fitted).is_causal]
        self.takes_off = tuple(fitted.effect for fitted, _ in kept)
        self._needs = {fitted.effect: linear_effect(fitted).needs(fitted) for fitted, _ in kept}
        self._squares = np.array([rms**2 for _, rms in kept]).reshape(-1, 9)
        self._stream = EffectStream(live, calibration.errors, calibration.array) if live else None

    def go_on(self, before: "Correction") -> None:
        """Go on where another correction is, so that effects with a memory do not begin anew with a new calibration.

        Parameters
        ----------
        before : Correction
            By another calibration; only effects that it has too go on.
        """
        if self._stream is not None and before._stream is not None:
            self._stream.go_on(before._stream)

    def why_left_in(self, name: str) -> str:
        """Return, in one clause, what keeps an effect of the calibration from being taken off.

        Parameters
        ----------
        name : str
            Of the effect.
        """
        effect = effect_named(name)
        if isinstance(effect, LinearEffect) and not effect.is_causal:
            return f"{name} needs later samples, tam correct takes it off a recording"
        return f"{name} needs the {' and '.join(map(channel_in_words, self._needs[name]))}, and none arrives"

    def correct(self, recording: Recording, codes: IntArray | None = None) -> CorrectedBatch:
        """Return the results of the next samples.

        Parameters
        ----------
        recording : Recording
            Readings of missing sensors as ``PartialCorrection.filled`` makes them.
        codes : (N,) array of int, optional
            Which sensors are missing: see ``missing_codes``.
        """
        is_left = np.ones((recording.sample_count, len(self.takes_off)), dtype=bool)
        if self._stream is not None:
            added = self._stream.added(recording)
            recording = without_rows(recording, added.rows_T)
            is_left[:, : added.is_known.shape[1]] = ~added.is_known
        readings, variance = recording.readings_T, is_left @ self._squares
        outputs = self._calibration.apply(readings)
        if codes is None:
            variance = self._calibration.output_standard_errors**2 + variance
        else:
            self.partial.put(outputs, readings, codes)
            variance = np.square(self.partial.standard_errors(codes)) + self.partial.growth(codes) * variance
        left_in = tuple(name for name, left in zip(self.takes_off, is_left.T, strict=True) if left.any())
        return CorrectedBatch(outputs, np.sqrt(variance), left_in, recording.scalar_T)
