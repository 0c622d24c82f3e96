"""Correcting samples as they arrive, in batches of any size, with what is known of them and with missing sensors.

With F_i (3 × 8) the fields at sensor i of a linear field x = bx by bz gxx gxy gxz gyy gyz, in which symmetry and trace
are, M_i its matrix, o_i its bias and σ_i its noise, the readings are y_i = M_i F_i x + o_i + ε_i. With A the stacked
M_i F_i / σ_i of the sensors that are there,

    x̂ = A⁺ (y - o) / σ,  cov x̂ = (AᵀA)⁺,

the generalised least-squares estimate (Gauss-Markov). An output lᵀx, gzz = -gxx - gyy among them, is determined exactly
where l lies in the row space of A, which is that of the stacked F_i: lᵀ A⁺A = lᵀ. Its variance is then lᵀ (AᵀA)⁺ l, to
which the calibration's own uncertainty is added. Other outputs are NaN, and so are their errors.

``ContradictionSearch`` finds sensors that fail during a survey: their corrected readings contradict those of all
others.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from tam_calibration.core.least_squares import Elimination
from tam_calibration.correction.calibration import Calibration, without_rows
from tam_calibration.correction.parts import Corrected
from tam_calibration.effects.effect import LinearEffect
from tam_calibration.effects.library import effect_named
from tam_calibration.effects.removal import EffectStream, linear_effect, of_array
from tam_calibration.model.array import OUTPUT_NAMES, UNIT_TENSORS
from tam_calibration.model.exceptions import MOST_NAMED, InputError, first_at
from tam_calibration.model.recording import Recording, channel_in_words
from tam_calibration.model.units import FloatArray, IntArray


class EffectRemoval:
    """Takes the effects that go with the array off batches of samples, in the order of time.

    Parameters
    ----------
    calibration : Calibration
        With effects or without.

    Raises
    ------
    InputError
        When an effect can only be taken off a complete recording.
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
        return without_rows(recording, added.rows_T).take(np.asarray(added.is_known.all(axis=1)))


def missing_codes(readings_T: FloatArray) -> IntArray:
    """Return for each sample a number whose bit k is set where sensor k + 1 is missing, all or part of its reading NaN.

    Parameters
    ----------
    readings_T : (N, K, 3) array
        Readings, tesla.

    Returns
    -------
    (N,) array of int
        0 where all sensors are there.
    """
    is_missing = np.isnan(readings_T).any(axis=2)
    return is_missing @ (1 << np.arange(readings_T.shape[1]))


def sensors_of(code: int) -> tuple[int, ...]:
    """Return the numbers, from 1, of the sensors that a code of `missing_codes` says are missing."""
    return tuple(bit + 1 for bit in range(code.bit_length()) if code >> bit & 1)


@dataclass(frozen=True, eq=False)
class PartialOutputs:
    """The outputs of an array without some of its sensors.

    Parameters
    ----------
    matrix : (9, 3K) array
        From the readings without bias to the outputs; zero for the sensors that are missing and for what is not
        determined.
    is_determined : (9,) array of bool
        Which outputs the others determine.
    covariance : (9, 9) array
        Of the outputs, as ``Calibration.output_covariance``; NaN for what is not determined.
    """

    matrix: FloatArray
    is_determined: np.ndarray
    covariance: FloatArray

    @cached_property
    def standard_errors(self) -> FloatArray:
        """(9,) standard errors of the outputs."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def not_determined(self) -> tuple[str, ...]:
        """Names of the outputs that are not determined."""
        return tuple(name for name, known in zip(OUTPUT_NAMES, self.is_determined, strict=True) if not known)


class PartialCorrection:
    """Outputs of samples that lack sensors; what they need of each set of sensors is computed once.

    Parameters
    ----------
    calibration : Calibration
        Of all sensors.
    """

    def __init__(self, calibration: Calibration) -> None:
        self._calibration = calibration
        self._outputs: dict[int, PartialOutputs] = {}
        self._fields: dict[int, FloatArray] = {}

    def without(self, code: int) -> PartialOutputs:
        """Return the outputs without some sensors.

        Parameters
        ----------
        code : int
            Which are missing: see `missing_codes`.
        """
        if code not in self._outputs:
            self._outputs[code] = _outputs_without(self._calibration, self._is_there(code))
        return self._outputs[code]

    def correct(self, recording: Recording, codes: IntArray) -> Corrected:
        """Return the outputs of a recording some samples of which lack sensors, as ``Calibration.correct`` does.

        Parameters
        ----------
        recording : Recording
            Raw readings, tesla; those of missing sensors do not matter.
        codes : (N,) array of int
            Of `missing_codes`; the result has None instead where no sample lacks any.

        Raises
        ------
        InputError
            As ``Calibration.correct``.
        """
        readings = recording.readings_T
        if self._calibration.effects:
            readings = self._calibration.readings_without_effects(
                replace(recording, readings_T=self.filled(readings, codes))
            )
        outputs = self._calibration.apply(readings)
        self.put(outputs, readings, codes)
        covariances = {code: self.without(code).covariance for code in np.unique(codes[codes > 0]).tolist()}
        errors = self._calibration.output_standard_errors
        return Corrected(recording.time_s, outputs, errors, codes if codes.any() else None, covariances)

    def put(self, outputs: FloatArray, readings_T: FloatArray, codes: IntArray) -> None:
        """Put the outputs of samples that lack sensors in their places.

        Parameters
        ----------
        outputs : (N, 9) array
            Of all samples; those that lack no sensor stay.
        readings_T : (N, K, 3) array
            Readings that no effect adds to, tesla; those of missing sensors do not matter.
        codes : (N,) array of int
            Of `missing_codes`.
        """
        for code in np.unique(codes[codes > 0]).tolist():
            rows = np.flatnonzero(codes == code)
            part, there = self.without(code), np.repeat(self._is_there(code), 3)
            unbiased = (readings_T[rows] - self._calibration.errors.bias_T).reshape(len(rows), -1)
            outputs[rows] = np.where(part.is_determined, unbiased[:, there] @ part.matrix[:, there].T, np.nan)

    def standard_errors(self, codes: IntArray) -> list[FloatArray]:
        """Return the standard errors (9,) of the outputs of each sample; of equal samples the same array."""
        whole = self._calibration.output_standard_errors
        return [self.without(code).standard_errors if code else whole for code in codes.tolist()]

    def growth(self, codes: IntArray) -> FloatArray:
        """Return by how much (N, 9) the squared noise of the outputs of each sample is that of all sensors."""
        whole = np.ones(9)
        parts = [self._calibration.growth_of(self.without(code).matrix) if code else whole for code in codes.tolist()]
        return np.array(parts)

    def covariance_with(self, standard_errors: FloatArray) -> FloatArray | None:
        """Return the covariance (9, 9) of the outputs without one or two sensors that have these standard errors.

        Parameters
        ----------
        standard_errors : (9,) array
            Of the outputs, T and T/m.

        Returns
        -------
        (9, 9) array or None
            None where no such sensors are missing.
        """
        bits = range(self._calibration.array.sensor_count)
        codes = [sum(1 << bit for bit in some) for count in (1, 2) for some in combinations(bits, count)]
        equal = (part for part in map(self.without, codes) if np.array_equal(part.standard_errors, standard_errors))
        return next((part.covariance for part in equal), None)

    def filled(self, readings_T: FloatArray, codes: IntArray) -> FloatArray:
        """Return readings in which missing ones are what the uniform field would be read as that the others agree on.

        Parameters
        ----------
        readings_T : (N, K, 3) array
            Readings, tesla, NaN where sensors are missing.
        codes : (N,) array of int
            Of `missing_codes`.

        Returns
        -------
        (N, K, 3) array
            NaN is left where no sensor is there.
        """
        errors, filled = self._calibration.errors, readings_T.copy()
        for code in np.unique(codes[codes > 0]).tolist():
            rows, is_there = np.flatnonzero(codes == code), self._is_there(code)
            if not is_there.any():
                continue
            unbiased = (readings_T[rows][:, is_there] - errors.bias_T[is_there]).reshape(len(rows), -1)
            expected = errors.distort(unbiased @ self._unmixing(code).T)
            filled[rows] = np.where(is_there[:, None], readings_T[rows], expected)
        return filled

    def _unmixing(self, code: int) -> FloatArray:
        if code not in self._fields:
            is_there = self._is_there(code)
            response = self._calibration.errors.matrix[is_there].reshape(-1, 3)
            noise_T = self._calibration.array.vector_noise_T[is_there]
            self._fields[code] = Elimination.of(response, 1 / np.repeat(noise_T, 3)).unmixing
        return self._fields[code]

    def _is_there(self, code: int) -> np.ndarray:
        return np.asarray(code >> np.arange(self._calibration.array.sensor_count) & 1 == 0)


def _outputs_without(calibration: Calibration, is_there: np.ndarray) -> PartialOutputs:
    """Return the outputs of the sensors that are there, a mask (K,)."""
    array, rows = calibration.array, np.repeat(is_there, 3)
    fields, gzz = array.linear_field[rows], np.append(np.zeros(3), UNIT_TENSORS[:, 2, 2])
    wanted = np.vstack([np.eye(8), gzz])
    if not array.has_gradient:
        fields, wanted = fields[:, :3], wanted[:, :3]
    # Part of an output, at most, that may lie outside what the sensors see: rounding, and a micrometre of a metre.
    determined = 1e-6
    seen = np.linalg.pinv(fields, rcond=determined) @ fields
    is_determined = np.abs(wanted @ seen - wanted).max(axis=1) < determined
    is_determined &= wanted.any(axis=1)
    weight = 1 / np.repeat(array.vector_noise_T[is_there], 3)
    response = (calibration.errors.matrix[is_there] @ fields.reshape(-1, 3, fields.shape[1])).reshape(fields.shape)
    scale = np.ones(fields.shape[1])
    scale[3:] = 1 / max(float(np.abs(fields[:, 3:]).max(initial=0.0)), np.finfo(float).tiny)
    whitened = weight[:, None] * response * scale
    estimate = scale[:, None] * np.linalg.pinv(whitened, rcond=determined) * weight
    matrix = np.zeros((9, len(rows)))
    matrix[np.ix_(is_determined, rows)] = wanted[is_determined] @ estimate
    covariance = calibration.covariance_of(matrix)
    covariance[~is_determined] = covariance[:, ~is_determined] = np.nan
    return PartialOutputs(matrix, is_determined, covariance)


_APART = 0.1
"""Smallest deviation of a failing sensor, as a part of the field: a dipole of 150 A m² makes 2 % of 50 µT at 3 m."""


def left_out(count: int, total: int, whose: str, when: str) -> str:
    """Return how many readings were left out because they contradict the others, and when they were made."""
    verbs = "contradicts the others and is" if count == 1 else "contradict the others and are"
    return f"{count} of {total} readings of {whose} {verbs} left out, {when}"


class ContradictionSearch:
    """Finds the failing sensors of samples, in the order of time, and counts them.

    Parameters
    ----------
    calibration : Calibration
        Of the sensors.
    """

    def __init__(self, calibration: Calibration) -> None:
        errors, count = calibration.errors, calibration.errors.sensor_count
        self._unmix, self._bias_T, self._sensor_count = np.linalg.inv(errors.matrix), errors.bias_T, count
        # Of the deviations from the mean of all, and of what a deviation of the least part of the others' field is.
        least_part = _APART * (1 - 1 / count) / (1 + _APART / count)
        weights = np.vstack([np.eye(count) - 1 / count, np.full(count, least_part / count)])
        self._deviations = np.einsum("ik,kab->kbia", weights, self._unmix).reshape(3 * count, -1)
        self._of_bias = self._bias_T.ravel() @ self._deviations
        self._signs = np.repeat([1.0, -1.0], [3 * count, 3])
        self._count, self._begin_s = 0, 0.0
        self._wrong, self._first_s = Counter[int](), dict[int, list[float]]()

    def codes_of(self, time_s: FloatArray, readings_T: FloatArray) -> IntArray:
        """Return which sensors fail in each sample (N,), as ``partial.missing_codes`` does.

        Parameters
        ----------
        time_s : (N,) array
            Time stamps of the samples, seconds.
        readings_T : (N, K, 3) array
            Raw readings, missing ones filled, tesla.
        """
        codes = np.zeros(len(time_s), dtype=np.int64)
        self._begin_s = self._begin_s if self._count else float(time_s[0])
        self._count += len(codes)
        # Sensors of which the others outvote one.
        if self._sensor_count >= 3:
            # One that fails deviates from the mean of all by (K - 1) / K of its deviation from the others. A sample in
            # which all sensors together deviate by less needs no closer look.
            parts = readings_T.reshape(len(readings_T), -1) @ self._deviations - self._of_bias
            excess = parts * parts @ self._signs
            if not all(each < 0 for each in excess.tolist()):
                is_suspect = ~(excess < 0)
                codes[is_suspect] = self._failing(time_s[is_suspect], readings_T[is_suspect])
        return codes

    def _failing(self, time_s: FloatArray, readings_T: FloatArray) -> IntArray:
        """Return the codes of samples, and count those of each sensor."""
        codes = np.zeros(len(time_s), dtype=np.int64)
        fields_T = np.einsum("kij,nkj->nki", self._unmix, readings_T - self._bias_T)
        for sensor in range(self._sensor_count):
            others_T = np.delete(fields_T, sensor, axis=1)
            center_T = others_T.mean(axis=1)
            spread_T = np.linalg.norm(others_T - center_T[:, None], axis=2).max(axis=1)
            # That deviation over the largest of the others: a dipole 0.6 m from the centre of a 0.5 m cross makes
            # at most 17.
            least_T = np.maximum(_APART * np.linalg.norm(center_T, axis=1), 20.0 * spread_T)
            is_wrong = np.linalg.norm(fields_T[:, sensor] - center_T, axis=1) > least_T
            codes[is_wrong] |= 1 << sensor
            self._wrong[sensor] += int(is_wrong.sum())
            first_s = self._first_s.setdefault(sensor, [])
            first_s += (time_s[is_wrong][: MOST_NAMED - len(first_s)] - self._begin_s).tolist()
        return codes

    def sentences(self) -> Iterator[str]:
        """Yield one sentence for each sensor that has failed until now."""
        for sensor, wrong in sorted((+self._wrong).items()):
            yield left_out(wrong, self._count, f"sensor {sensor + 1}", first_at(self._first_s[sensor]))


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
        kept = [(fitted, size.rms) for fitted, size in sizes if of_array([fitted])]
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
        codes = np.zeros(recording.sample_count, dtype=np.int64) if codes is None else codes
        outputs = self._calibration.apply(recording.readings_T)
        self.partial.put(outputs, recording.readings_T, codes)
        variance = self.partial.growth(codes) * (is_left @ self._squares)
        variance += np.square(self.partial.standard_errors(codes))
        left_in = tuple(name for name, left in zip(self.takes_off, is_left.T, strict=True) if left.any())
        return CorrectedBatch(outputs, np.sqrt(variance), left_in, recording.scalar_T)
