"""The result of a fit: the sensors' errors with their covariance, how good they are, and how to apply them."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from typing import Any, Literal, overload

import numpy as np

from tam_calibration.core.noise import VarianceFactors
from tam_calibration.correction.parts import (
    Corrected,
    EffectSize,
    Grade,
    KnownSource,
    Provenance,
    Quality,
    Update,
    quality_for,
    residual_in_words,
)
from tam_calibration.effects.removal import added_to, of_sensors, removable
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.fitted_effect import FittedEffect
from tam_calibration.model.libraries import require
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import Residuals, ResidualSeries, SensorErrors, residual_series
from tam_calibration.model.units import FloatArray

FRAME_STATEMENT = (
    "The array frame is the orthogonal frame of sensor 1: z along its z axis, y in the plane of its y and z axes. "
    "A uniform field cannot see how that frame is turned against the baselines: the three angles of this rotation, "
    "common to all sensors, stay unknown and are taken as zero."
)
_SCALE_STATEMENT = (
    "Without a scalar reference the absolute scale is unknown: the determinants of the matrices are given the "
    "geometric mean 1, and the intensity is on that scale too. --place LAT,LON,DATE takes the intensity from IGRF."
)
_EFFECTS_STATEMENT = (
    "Effects were fitted together with the errors; residuals are those without what they add, and data are corrected "
    "without it. An effect of the site stays in the data."
)


@dataclass(frozen=True, eq=False)
class Calibration:
    """The estimated errors of an array's sensors.

    Parameters
    ----------
    method : str
        Name of the fit.
    array : Array
        Geometry, and the noise that the fit used.
    noise_is_estimated : bool
        Whether a noise was not stated and was estimated from the recording.
    errors : SensorErrors
        The estimate. What the data cannot determine is zero: see ``statements``.
    covariance : (12 K, 12 K) array
        Of ``errors.to_vector()`` flattened, SI; zero for what is fixed.
    has_scalar_reference : bool
        Whether the absolute scale comes from a scalar reference, or from what ``reference`` names.
    intensity_T : float
        Mean intensity of the field of the recording: the reference's, or the fitted constant, tesla.
    before, in_sample, floor : Residuals
        Residuals of the raw and of the corrected recording, and of sensor noise alone.
    samples : int
        Number of samples of the recording.
    time_span_s : (float, float)
        First and last time stamp of the recording, seconds.
    coverage : float
        Fraction of the sphere of field directions that the recording visited.
    reduced_chi_square : dict
        ``differential`` (between sensors) and ``common_mode`` (against the scalar) whitened residual energy per
        degree of freedom; 1 for noise alone. Empty without redundancy. For residuals that are larger than noise or
        correlated in time it also has ``slow_differential`` or ``slow_common_mode``: see ``variance_factors``.
    warnings : tuple of str
        Reasons to doubt the calibration, one sentence each: what is wrong and, after the last colon, what to do.
    notes : tuple of str
        What was done to the recording before the fit, such as readings that were left out, one sentence each. They
        do not affect the grade.
    held_out : Residuals, optional
        Residuals of samples that the fit did not see.
    source : Provenance, optional
        Where the recording came from.
    frame : str
        Description of the array frame, one or more sentences.
    effects : tuple of FittedEffect
        Effects that were fitted with the errors, if requested. Corrections remove those that belong to the array.
    effect_sizes : tuple of EffectSize
        Size of each effect, if known.
    known_source : KnownSource, optional
        What a known source showed, if one was recorded.
    accepted : tuple of str
        Names of exceeded limits that the user accepted: see ``correction.acceptance``.
    temperature_C : float, optional
        Mean temperature of the recording, if recorded.
    update : Update, optional
        How it follows from the prior, if there was one; a file keeps that for people, and it is not read again.
    reference : str
        What gives the absolute scale in place of a scalar magnetometer, such as IGRF; empty otherwise.

    Examples
    --------
    >>> from tam_calibration import calibrate, read_scenario, simulate
    >>> made = simulate(read_scenario("wu_table_1"))
    >>> calibration = calibrate(made.recording, made.scenario.array)
    >>> (calibration.errors.bias_T[0] * 1e9).round()  # nT, sensor 1; the truth is 36, 22, -24
    array([ 36.,  22., -24.])
    >>> calibration.standard_errors.shape, calibration.has_scalar_reference
    ((4, 12), True)
    >>> outputs, standard_errors = calibration.apply(made.recording.readings_T, with_errors=True)
    >>> residuals = calibration.residuals(made.recording)
    >>> (residuals.sensor_intensity_T.std(axis=0) * 1e9).round()  # nT, as the noise of the sensors
    array([1., 1., 1., 1.])
    >>> calibration.plot(made.recording).savefig("calibration.png")
    """

    method: str
    array: KnownNoiseArray
    noise_is_estimated: bool
    errors: SensorErrors
    covariance: FloatArray
    has_scalar_reference: bool
    intensity_T: float
    before: Residuals
    in_sample: Residuals
    floor: Residuals
    samples: int
    time_span_s: tuple[float, float]
    coverage: float
    reduced_chi_square: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    held_out: Residuals | None = None
    source: Provenance | None = None
    frame: str = FRAME_STATEMENT
    effects: tuple[FittedEffect, ...] = ()
    effect_sizes: tuple[EffectSize, ...] = ()
    known_source: KnownSource | None = None
    accepted: tuple[str, ...] = ()
    temperature_C: float | None = None
    update: Update | None = None
    reference: str = ""

    @property
    def best_residuals(self) -> Residuals:
        """The residuals to judge by: of held-out samples where there are any."""
        return self.held_out or self.in_sample

    @property
    def quality(self) -> Quality:
        """Its grade, the reasons for that, and what to do next: bad where its residual had to be accepted."""
        grade: Grade = "doubtful" if self.warnings else "good"
        if "residual" in self.accepted:
            grade = "bad"
        seen = "held-out samples" if self.held_out else "the samples of the fit"
        headline = residual_in_words(self.best_residuals, self.floor, seen)
        origin = ", estimated from the same recording" if self.noise_is_estimated else ""
        scale = "" if self.has_scalar_reference else "; the absolute scale is unknown"
        return quality_for(grade, self.warnings, f"{headline}{origin}{scale}")

    @property
    def channels_in_words(self) -> dict[str, str]:
        """What the two kinds of ``reduced_chi_square`` compare."""
        intensity = "reference" if self.has_scalar_reference else "fitted"
        return {"differential": "between the sensors", "common_mode": f"against the {intensity} intensity"}

    @property
    def statements(self) -> tuple[str, ...]:
        """Sentences on the frame and on what the data could not determine."""
        scale = () if self.has_scalar_reference else (_SCALE_STATEMENT,)
        effects = (_EFFECTS_STATEMENT,) if self.effects else ()
        return (self.frame, *scale, *effects)

    def is_of(self, array: Array) -> bool:
        """Whether it is of an array as stated, whose baselines a known source may have corrected since.

        Parameters
        ----------
        array : Array
            As its file states it; its noise does not matter.

        Returns
        -------
        bool
            True where the sensors are at the same places, to a micrometre.
        """
        if self.known_source is None or self.array.has_geometry_of(array):
            return self.array.has_geometry_of(array)
        stated = self.array.positions_m / self.known_source.baseline_scale
        return replace(self.array, positions_m=stated, axis_offsets_m=None).has_geometry_of(array)

    @property
    def variance_factors(self) -> VarianceFactors:
        """Factors by which the variances of each channel exceed those of white noise of the stated size."""
        factors = self.reduced_chi_square
        return VarianceFactors(factors.get("slow_differential", 1.0), factors.get("slow_common_mode", 1.0))

    @cached_property
    def standard_errors(self) -> FloatArray:
        """(K, 12) standard errors in the order of ``errors.PARAMETER_NAMES``."""
        return np.sqrt(np.diag(self.covariance)).reshape(self.errors.sensor_count, 12)

    @cached_property
    def correction_matrix(self) -> FloatArray:
        """(9, 3K) matrix C of outputs = C (y - o), y the stacked raw readings and o the stacked biases."""
        return np.asarray(self.array.operator @ self.errors.joint_inverse)

    @cached_property
    def output_standard_errors(self) -> FloatArray:
        """(9,) standard errors of the outputs: sensor noise, the calibration's own error and that of its effects.

        The second part is the root mean square over all directions of a field of the calibration's intensity.
        """
        return np.asarray(np.sqrt(np.diag(self.output_covariance)))

    @cached_property
    def output_covariance(self) -> FloatArray:
        """(9, 9) covariance of the outputs, as localisation needs it: what their standard errors are of.

        Effects count as independent from output to output.
        """
        return self.covariance_of(self.correction_matrix)

    def covariance_of(self, matrix: FloatArray) -> FloatArray:
        """Return the covariance of the outputs that a matrix makes of the readings.

        What is not known of an effect is that of the outputs of all sensors, grown as the noise grows.

        Parameters
        ----------
        matrix : (9, 3K) array
            From the readings without bias to the outputs.

        Returns
        -------
        (9, 9) array
            As ``output_covariance``.
        """
        # The mean over all directions of the field.
        by_parameter, mean_square = self._by_parameter(matrix), np.repeat([self.intensity_T**2 / 3, 1.0], [3, 1])
        own = np.einsum("rdp,pq,sdq,d->rs", by_parameter, self.covariance, by_parameter, mean_square, optimize=True)
        return np.asarray(self._noise_covariance(matrix) + own)

    def _noise_covariance(self, matrix: FloatArray) -> FloatArray:
        """Return the part of ``covariance_of`` that sensor noise and effects make."""
        effects = sum((size.standard_errors**2 for size in self.effect_sizes), start=np.zeros(9))
        noise: FloatArray = matrix * np.repeat(self.array.vector_noise_T**2, 3) @ matrix.T
        return noise + np.diag(self.growth_of(matrix) * effects)

    def growth_of(self, matrix: FloatArray) -> FloatArray:
        """Return by how much the noise of the outputs that a matrix makes exceeds that of all sensors.

        Parameters
        ----------
        matrix : (9, 3K) array
            From the readings without bias to the outputs.

        Returns
        -------
        (9,) array
            Ratio of the variances of equal sensors; 1 for ``correction_matrix``.
        """
        return np.asarray((matrix**2).sum(axis=1) / (self.correction_matrix**2).sum(axis=1))

    def _by_parameter(self, matrix: FloatArray) -> FloatArray:
        """Return (9, 4, 12 K) derivatives of the outputs by the parameters for each component of the field, and 1."""
        # d output = -C_i (dM_i b + do_i)
        sensors = matrix.reshape(9, self.errors.sensor_count, 3)
        return np.asarray(np.einsum("rki,kidp->rdkp", sensors, self.errors.jacobian()).reshape(9, 4, -1))

    def correct(self, recording: Recording) -> Corrected:
        """Return the centre vector and gradient tensor of raw readings, what the effects of the sensors add taken off.

        Parameters
        ----------
        recording : Recording
            Raw readings (N, K, 3), tesla, of the array that was calibrated.

        Returns
        -------
        Corrected
            (N, 9) outputs in the array frame, tesla and T/m, and the standard error of each column.

        Raises
        ------
        InputError
            When the recording has another number of sensors or lacks a channel that an effect needs, or its readings
            are not geomagnetic in tesla.
        """
        return Corrected(
            recording.time_s, self.apply(self.readings_without_effects(recording)), self.output_standard_errors
        )

    def readings_without_effects(self, recording: Recording) -> FloatArray:
        """Return the readings without what effects that go with the array add to them.

        Parameters
        ----------
        recording : Recording
            As of ``correct``.

        Returns
        -------
        (N, K, 3) array
            Raw still, tesla.

        Raises
        ------
        InputError
            As ``correct``.
        """
        return self._without(of_sensors(self.effects), recording).readings_T

    def without_effects(self, recording: Recording) -> Recording:
        """Return the recording as it would be if no effect had added to its sensors and its scalar.

        Parameters
        ----------
        recording : Recording
            Of the array that was calibrated, with the channels that the effects follow.

        Returns
        -------
        Recording
            With readings and scalar that are raw still, tesla; itself where the calibration has no effects.

        Raises
        ------
        InputError
            As ``correct``.
        """
        return self._without(removable(self.effects), recording)

    def residuals(self, recording: Recording) -> ResidualSeries:
        """Return the residuals of a recording in a uniform field, effects of the calibration removed.

        Parameters
        ----------
        recording : Recording
            N samples of the array that was calibrated; without a scalar the calibration's intensity is the reference.

        Returns
        -------
        ResidualSeries
            Intensity less the reference of each sensor (N, K) and of the centre (N,), tesla; gradient tensor (N, 5),
            T/m.

        Raises
        ------
        InputError
            As ``correct``.
        """
        return residual_series(self.errors, self.array, self.without_effects(recording), self.intensity_T)

    def plot(self, recording: Recording) -> Any:
        """Draw the residuals of a recording over time, before and after calibration, and the directions of its field.

        Parameters
        ----------
        recording : Recording
            Of the array that was calibrated.

        Returns
        -------
        matplotlib.figure.Figure
            Save it with ``savefig``.

        Raises
        ------
        InputError
            As ``correct``, or when matplotlib is not installed.
        """
        require("report", "Calibration.plot")
        figures = import_module("tam_calibration.report.calibration_report")  # a room above: loaded when it is used
        return figures.plot_calibration(self, recording)

    @overload
    def apply(self, readings_T: FloatArray, with_errors: Literal[False] = False) -> FloatArray: ...

    @overload
    def apply(self, readings_T: FloatArray, with_errors: Literal[True]) -> tuple[FloatArray, FloatArray]: ...

    def apply(self, readings_T: FloatArray, with_errors: bool = False) -> FloatArray | tuple[FloatArray, FloatArray]:
        """Return the outputs of readings that no effect adds to; no sample depends on its neighbours.

        Parameters
        ----------
        readings_T : (N, K, 3) array
            Raw readings along the sensors' own axes, tesla.
        with_errors : bool
            Whether to return the standard errors too. Unlike ``output_standard_errors``, which is their root mean
            square over all directions, they are for the field of each sample.

        Returns
        -------
        (N, 9) array, or two of them
            Outputs in the order of ``array.OUTPUT_NAMES``, array frame, tesla and T/m; standard errors of each.
        """
        unbiased = (readings_T - self.errors.bias_T).reshape(len(readings_T), -1)
        outputs: FloatArray = np.einsum("nj,ij->ni", unbiased, self.correction_matrix)
        if not with_errors:
            return outputs
        variance = np.tile(np.diag(self._noise_covariance(self.correction_matrix)), (len(readings_T), 1))
        field_T = np.pad(self.errors.restore(readings_T), ((0, 0), (0, 0), (0, 1)), constant_values=1.0)
        field_T = field_T.reshape(len(field_T), -1)
        covariance = self.covariance.reshape(-1, 12, self.errors.sensor_count, 12)
        for output, by_parameter in enumerate(self._by_parameter(self.correction_matrix)):
            own = by_parameter.reshape(4, -1, 12)
            quadratic = np.einsum("dkp,kplq,clq->kdlc", own, covariance, own, optimize=True)
            variance[:, output] += ((field_T @ quadratic.reshape(field_T.shape[1], -1)) * field_T).sum(axis=1)
        return outputs, np.sqrt(variance)

    def _without(self, effects: tuple[FittedEffect, ...], recording: Recording) -> Recording:
        """Return a recording of this array without what some effects add to it."""
        if recording.sensor_count != self.errors.sensor_count:
            raise InputError(
                f"the calibration is of {self.errors.sensor_count} sensors, the recording of {recording.sensor_count}: "
                "use the calibration of this array"
            )
        recording.check_units(self.array.field)
        if not effects:
            return recording
        rows_T = added_to(recording, effects, self.errors, self.array)
        return without_rows(recording, rows_T, None if self.has_scalar_reference else self.errors)


def without_rows(recording: Recording, rows_T: FloatArray, errors: SensorErrors | None = None) -> Recording:
    """Return a recording less what effects add to it.

    Parameters
    ----------
    recording : Recording
        Of K sensors.
    rows_T : (N, 3 K + 1) array
        What is added to the axes of all sensors and to the scalar, tesla.
    errors : SensorErrors, optional
        Of an array without a scalar: what is added to a constant intensity is then what the field itself lacks.
    """
    readings = recording.readings_T - rows_T[:, :-1].reshape(recording.readings_T.shape)
    if recording.scalar_T is not None:
        return replace(recording, readings_T=readings, scalar_T=recording.scalar_T - rows_T[:, -1])
    if errors is not None:
        lacking = rows_T[:, -1:] / np.linalg.norm(errors.restore(readings), axis=2)
        readings += lacking[:, :, None] * (readings - errors.bias_T)
    return replace(recording, readings_T=readings)
