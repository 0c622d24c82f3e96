"""What no sensor of an array is: a calibration beyond these limits is of another unit, or went wrong.

Nor should the corrected field be longer or shorter than the scalar magnetometer of the array reads it.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from tam_calibration.core.least_squares import whitening
from tam_calibration.correction.calibration import Calibration
from tam_calibration.model.data_sheet import LARGEST_TOLERANCES
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.units import FloatArray, to_degrees, to_nanotesla

LIMITS = {
    "bias": "a reading in zero field beyond the range of sensors of the Earth's field",
    "non_orthogonality": "axes far from being orthogonal",
    "one_sensor": "two channels with the same errors, as if both read one sensor",
    "residual": "intensities far from those of the field",
    "scale_factor": "an axis in another unit, or of another gain, than the others",
}
"""Names of the limits, for messages and `--accept`, and what each is."""


LARGEST_RATIO = 2.0
"""Of the scale factors of two axes of a sensor. Data sheets allow some per cent, soft iron some ten per cent."""

LARGEST_NON_ORTHOGONALITY = LARGEST_TOLERANCES["non_orthogonality"]
"""Of two axes, radians: ten times that of the worst chips; axes that are glued by hand are within it."""

_LARGEST_BIAS_T = LARGEST_TOLERANCES["bias_T"]
"""Tesla: beyond the range of sensors that read the field of the Earth; near the magnets of a phone it is 0.6 mT."""


LARGEST_RELATIVE_ERROR = 0.005
"""Part of the intensity, 250 nT, as large as the errors that are to be found: a standard error of a bias, or of a scale
factor, is larger if the parameter is open; the residual of sensors whose noise is stated may not exceed it."""

LARGEST_ANGLE_ERROR = 0.01
"""Standard error of an angle, radians, beyond which it is open: as large as the misalignments that are to be found."""


WRONG_PART = 0.01
"""Part of the intensity, some 500 nT: more in most samples, or in a part of a recording, is another array or unit."""


def are_possible(vector: FloatArray) -> bool:
    """Return whether sensors may have such errors while a fit is on its way.

    Parameters
    ----------
    vector : (K, 12) array
        In the order of ``SensorErrors.to_vector``.
    """
    scale_factor, skew = vector[:, :3], np.abs(vector[:, 3:6])
    # Scale factor of a sensor with another unit: far beyond, gradients vanish, and a fit may settle anywhere.
    is_scaled = (scale_factor > 0) & (scale_factor < 1e3)
    # np.pi / 2: non-orthogonality at which two axes of a sensor coincide, radians.
    return bool(is_scaled.all() and (skew <= np.pi / 2).all())


def beyond_limits(calibration: Calibration) -> dict[str, str]:
    """Return what is beyond the limits: by the name of each, a sentence on the sensor that is worst."""
    errors = calibration.errors
    found = {
        "scale_factor": _scale_factor(errors.scale_factor),
        "non_orthogonality": _non_orthogonality(errors.non_orthogonality),
        "bias": _bias(errors.bias_T),
        "one_sensor": _one_sensor(calibration),
        "residual": _residual(calibration),
    }
    return {name: sentence for name, sentence in found.items() if sentence}


def within_limits(calibration: Calibration, accept: Collection[str]) -> Calibration:
    """Return a calibration that is within the limits, or beyond those alone that are accepted: this is a warning.

    Parameters
    ----------
    calibration : Calibration
        As it was fitted.
    accept : collection of str
        Names of `LIMITS`.

    Raises
    ------
    Refused
        When it is beyond another limit; the sentence has its name.
    """
    beyond = beyond_limits(calibration)
    for name, sentence in beyond.items():
        if name not in accept:
            raise Refused(f"{sentence}; where that is so, accept {name}")
    accepted = *calibration.accepted, *beyond
    return replace(calibration, accepted=accepted, warnings=(*beyond.values(), *calibration.warnings))


def _scale_factor(factor: FloatArray) -> str:
    sensor, axis, value = _worst(factor, np.abs(np.log(factor)))
    # Least and largest: chips are within 30 % of their data sheets, and the nearest other unit is ten times
    # away.
    least, most = (0.5, 2.0)
    ratio = factor.max(axis=1) / factor.min(axis=1)
    if not least <= value <= most:
        return (
            f"the scale factor of sensor {sensor} {axis} is {value:.3g}, not between {least} and {most}: that axis has "
            "another unit or gain than the others"
        )
    if ratio.max() > LARGEST_RATIO:
        return (
            f"the scale factors of sensor {int(ratio.argmax()) + 1} differ by a factor of {ratio.max():.3g}, more than "
            f"{LARGEST_RATIO:g}: an axis has another unit or gain than the others"
        )
    return ""


def _non_orthogonality(angle: FloatArray) -> str:
    sensor, _, value = _worst(angle, np.abs(angle))
    if abs(value) <= LARGEST_NON_ORTHOGONALITY:
        return ""
    return (
        f"the axes of sensor {sensor} are {abs(to_degrees(value)):.3g}° from being orthogonal, more than "
        f"{to_degrees(LARGEST_NON_ORTHOGONALITY):.0f}°: the readings do not cover the sphere, or two axes are one"
    )


def _bias(bias_T: FloatArray) -> str:
    sensor, axis, value = _worst(bias_T, np.abs(bias_T))
    if abs(value) <= _LARGEST_BIAS_T:
        return ""
    return (
        f"the bias of sensor {sensor} {axis} is {to_nanotesla(value):.4g} nT, more than "
        f"{to_nanotesla(_LARGEST_BIAS_T):.0f} nT: no sensor of the field of the Earth reads so far"
    )


def _residual(calibration: Calibration) -> str:
    """Compare the intensities, and the fields between the sensors, with the noise and with the field."""
    residual_T, array = calibration.in_sample.sensor_intensity_T, calibration.array
    sensor = int(np.argmax(residual_T))
    between = float(np.sqrt(calibration.reduced_chi_square.get("differential", 0.0)))
    own_T, floor_T = residual_T[sensor], calibration.floor.sensor_intensity_T[sensor]
    found = (
        (own_T, own_T / floor_T, f"of sensor {sensor + 1}"),
        (between * np.sqrt(np.mean(array.vector_noise_T**2)), between, "between the sensors"),
    )
    for size_T, excess, words in found:
        # Ratio of a residual to its noise floor from which ``LARGEST_RELATIVE_ERROR`` counts: a room's gradient
        # or a vehicle's currents leave ten times the noise of good sensors.
        # The residuals of a robust fit hold the outliers that it held down.
        is_noisy = calibration.noise_is_estimated or calibration.method == "robust" or excess <= 300.0
        # Part of the intensity, some 2.5 µT, that the fit may leave: twice what a phone's chip leaves with its
        # currents.
        limit = 0.05 if is_noisy else LARGEST_RELATIVE_ERROR
        if size_T > limit * calibration.intensity_T:
            return (
                f"the fit leaves {to_nanotesla(size_T):.4g} nT {words}, more than {100 * limit:g}% of the field"
                f"{'' if is_noisy else f' and {excess:.3g} times the noise'}: its readings are not those of one sensor "
                "turned in one field, look for the cause with tam diagnose"
            )
    return ""


def _one_sensor(calibration: Calibration) -> str:
    """Compare the errors of each two sensors; where those of all are equal, a simulator gave all the same."""
    errors, covariance, count = calibration.errors.to_vector(), calibration.covariance, calibration.errors.sensor_count
    # Sensors of which two may have the same errors and others not; parameters that are open may have any.
    if count < 3 or not np.isfinite(covariance).all():
        return ""
    blocks = covariance.reshape(count, 12, count, 12)

    def distance(difference: FloatArray, spread: FloatArray) -> float:
        return float(np.sum((whitening(spread, 1e-15).T @ difference) ** 2))

    same = []
    # Squared distance of two sensors' twelve errors over its variance; by chance one pair in a thousand has more. 12 +
    # 2 √(12 ln 1000) + 2 ln 1000, by Laurent and Massart 2000, lemma 1.
    same_errors = 44.0
    for one, other in combinations(range(count), 2):
        own, its, shared = blocks[one, :, one], blocks[other, :, other], blocks[one, :, other]
        if distance(errors[one] - errors[other], own + its - shared - shared.T) < same_errors:
            same.append((one, other))
    if not same or len(same) == count * (count - 1) // 2:
        return ""
    one, other = same[0]
    # Times that distance, by which errors must differ from those of an ideal sensor: others are small, or
    # unknown.
    if distance(errors[other] - np.repeat([1.0, 0.0], [3, 9]), blocks[other, :, other]) < 100.0 * same_errors:
        return ""
    return (
        f"sensors {one + 1} and {other + 1} have the same errors, all twelve within their standard errors: both "
        "channels seem to read one sensor, look at the wiring and at the multiplexer"
    )


def _worst(values: FloatArray, size: FloatArray) -> tuple[int, str, float]:
    """Return sensor, counted from 1, axis and value where a size (K, 3) is largest."""
    sensor, axis = divmod(int(np.argmax(size)), 3)
    return sensor + 1, "xyz"[axis], float(values[sensor, axis])


@dataclass
class ScalarAgreement:
    """The residuals |B| − scalar of samples that have both.

    Parameters
    ----------
    samples : int
        How many there are.
    wrong : int
        Those whose residual exceeds a hundredth of the intensity.
    squares_T2 : float
        Sum of the squares of the residuals.
    squares_T2_per_m2 : float
        The same of the gradients.
    """

    samples: int = 0
    wrong: int = 0
    squares_T2: float = 0.0
    squares_T2_per_m2: float = 0.0

    def add(self, outputs: FloatArray, scalar_T: FloatArray) -> None:
        """Add samples.

        Parameters
        ----------
        outputs : (N, 3) or (N, 9) array
            Corrected field at the centre, tesla, and gradient, T/m, where it counts; NaN where they are not determined.
        scalar_T : (N,) array
            Readings of the scalar magnetometer, tesla; NaN where there is none.
        """
        residual = np.linalg.norm(outputs[:, :3], axis=1) - scalar_T
        is_known = np.isfinite(residual)
        self.samples += int(np.count_nonzero(is_known))
        self.wrong += int(np.count_nonzero(np.abs(residual[is_known]) > WRONG_PART * scalar_T[is_known]))
        self.squares_T2 += float(np.sum(residual[is_known] ** 2))
        self.squares_T2_per_m2 += float(np.nansum(outputs[is_known, 3:] ** 2))

    @property
    def residual_T(self) -> float:
        """Root mean square of the residuals, tesla; NaN where there is none."""
        return float(np.sqrt(self.squares_T2 / self.samples)) if self.samples else np.nan

    @property
    def is_wrong(self) -> bool:
        """Whether most samples are off by more than any use of this calibration makes them."""
        return 2 * self.wrong > self.samples

    @property
    def gradient_T_per_m(self) -> float:
        """Root mean square of the length of the gradient, T/m; NaN where there is none."""
        return float(np.sqrt(self.squares_T2_per_m2 / self.samples)) if self.samples else np.nan

    def _is_near_source(self, calibration: Calibration) -> bool:
        """Whether the gradient is as large as a source makes it whose field bends by the residual."""
        size_m = float(np.linalg.norm(calibration.array.positions_m, axis=1).max())
        # A bias that moves makes four residuals of it over the array; a source at three times its size 40.
        return size_m * self.gradient_T_per_m > 10.0 * self.residual_T

    def is_doubtful(self, calibration: Calibration) -> bool:
        """Whether the residual is larger than the calibration left it, and no source near explains that."""
        return self._exceeds(calibration) and not self._is_near_source(calibration)

    def _exceeds(self, calibration: Calibration) -> bool:
        least_T = max(calibration.floor.center_intensity_T, calibration.in_sample.center_intensity_T)
        # Residual over the noise floor, or over what the fit left, above which a new calibration is advised.
        return self.residual_T > 3.0 * least_T

    def sentence(self, calibration: Calibration) -> str:
        """Return the residual and the noise floor, and what to do if they do not agree."""
        floor_nT = to_nanotesla(calibration.floor.center_intensity_T)
        compared = f"|B| − scalar is {to_nanotesla(self.residual_T):.3g} nT, noise floor {floor_nT:.3g} nT"
        if self.is_wrong:
            return f"{compared}: the calibration is not of this array, or a sensor or the scalar has another unit"
        if not self._exceeds(calibration):
            return compared
        if not self._is_near_source(calibration):
            return f"{compared}: calibrate again"
        gradient = f"a gradient of {to_nanotesla(self.gradient_T_per_m):.3g} nT/m"
        return f"{compared}, in {gradient}: near a source they do not compare; away from any, calibrate again"
