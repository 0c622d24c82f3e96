"""Chi 2017: the simulation of 200 attitudes in 50 000 nT with hard and soft iron, Tables 2 and 3, and Table 4.

ψ of sensor 1 must be -0.025 where Table 1 prints +0.025: then Table 2 comes out. The attitudes are not printed. Of 27
ways to draw them one gives the tensor of Table 3 before calibration: the field's angle from the x axis and its turn
about it are uniform.
"""

from dataclasses import replace

import numpy as np
from numpy.linalg import inv, norm

from tam_calibration.fit.published import integrated
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_nanotesla, to_degrees, to_nanotesla
from tam_validation.papers.cross import SetUp, intensity_rms_T, site_field, tensor_rms_T_per_m
from tam_validation.papers.li2018a import aligned_angles
from tam_validation.papers.printed import printed_in
from tam_validation.papers.row import Draws, right_name

_BASELINE_M = 0.5
_SAMPLES = 200
_VARIANCES_NT2 = (9.0, 12.0, 15.0)
_SITE = site_field(from_nanotesla(50_000.0), 55.0, -7.0)
"""The simulation as the paper states it, section 3."""

_EXPERIMENT_SITE = site_field(from_nanotesla(52_561.0), 55.0, -7.0)
_EXPERIMENT_BASELINE_M, _EXPERIMENT_SAMPLES = 0.26, 30
"""The experiment as the paper states it, section 4."""

_PRINTED = printed_in("chi2017")
NON_ORTHOGONALITY = np.array(_PRINTED["non_orthogonality"])
"""θ, φ, ψ of the sensors [rad]; ψ of sensor 1 with its sign reversed."""
COMBINED_BIAS_NT = np.array(_PRINTED["combined_bias_nT"])
_UPPER = np.triu_indices(3)
_FRAME = "Section 3.1, turn of the calibrated frame of sensor 1 from its own"


def set_up(variance_nT2: float = 9.0, seed: int = 0, non_orthogonality: FloatArray = NON_ORTHOGONALITY) -> SetUp:
    """Return the cross of Table 1 and its readings, with the attitude of the platform.

    Parameters
    ----------
    variance_nT2 : float
        Variance of the noise of each axis, nT².
    seed : int
        Of the random attitudes and noise.
    non_orthogonality : (4, 3) array
        θ, φ, ψ of the sensors, radians.
    """
    return _observed(true_errors(non_orthogonality), _SITE, _SAMPLES, _BASELINE_M, variance_nT2, seed)


def experiment(seed: int, variance_nT2: float = 9.0) -> SetUp:
    """Return the cross of section 4.2, of whose errors nothing is printed, with those of the simulation."""
    size = _EXPERIMENT_SITE, _EXPERIMENT_SAMPLES, _EXPERIMENT_BASELINE_M
    return _observed(true_errors(), *size, variance_nT2, seed)


def _observed(
    errors: SensorErrors, site_T: FloatArray, count: int, baseline_m: float, variance_nT2: float, seed: int
) -> SetUp:
    from scipy.spatial.transform import Rotation

    generator = np.random.default_rng(seed)
    onto_x, _ = Rotation.align_vectors([[1.0, 0.0, 0.0]], site_T[None] / norm(site_T))
    to_array = Rotation.from_euler("zx", generator.uniform(0, 2 * np.pi, (count, 2))) * onto_x
    attitude, field = to_array.inv(), to_array.apply(site_T)
    noise_T = from_nanotesla(float(np.sqrt(variance_nT2)))
    readings = errors.distort(field) + noise_T * generator.normal(size=(count, 4, 3))
    intensity = np.full(count, float(norm(site_T)))
    recording = Recording(np.arange(float(count)), readings, intensity, attitude=attitude.as_quat())
    return SetUp(Array.cross(baseline_m, noise_T, 0.0), baseline_m, errors, field, recording)


def true_errors(non_orthogonality: FloatArray = NON_ORTHOGONALITY) -> SensorErrors:
    """Return S C_NO (1 + K) R and the combined bias of eq. 5 in the frame of the platform.

    Parameters
    ----------
    non_orthogonality : (4, 3) array
        θ, φ, ψ of the sensors, radians.
    """
    zero = np.zeros((4, 3))
    sensor = SensorErrors(np.array(_PRINTED["scale_factor"]), non_orthogonality, zero, zero).measurement
    alpha, beta, gamma = np.array(_PRINTED["misalignment"]).T
    none = np.zeros(4)
    # Ry(γ) Rx(β) Rz(α), a product of two rotations in the order Rx Ry Rz.
    first = SensorErrors(zero + 1, zero, zero, np.stack([none, gamma, none], axis=1)).rotation
    then = SensorErrors(zero + 1, zero, zero, np.stack([beta, none, alpha], axis=1)).rotation
    matrix = sensor @ (np.eye(3) + np.array(_PRINTED["soft_iron"])) @ first @ then
    bias = from_nanotesla(np.einsum("kij,kj->ki", sensor, _PRINTED["hard_iron_nT"]) + _PRINTED["bias_nT"])
    return SensorErrors.from_matrix(matrix, bias)


def _with_psi(psi: float) -> FloatArray:
    """Return the θ, φ, ψ of the sensors with another ψ of sensor 1, radians."""
    angles = NON_ORTHOGONALITY.copy()
    angles[0, 2] = psi
    return angles


def simulate(seed: int, as_published: bool) -> Draws:
    """Return what one simulation gives, by the findings of the paper.

    Parameters
    ----------
    seed : int
        Of noise and attitudes.
    as_published : bool
        Whether ψ of sensor 1 has the sign of Table 1, and not the one from which Table 2 comes out.
    """
    sign = -1 if as_published else 1
    angles = _with_psi(sign * NON_ORTHOGONALITY[0, 2])
    cases = [set_up(variance, seed, angles) for variance in _VARIANCES_NT2]
    fitted = [calibrate(case) for case in cases]
    errors, readings = fitted[0], cases[0].recording.readings_T
    fields = errors.restore(readings)
    restored = [each.restore(case.recording.readings_T) for case, each in zip(cases, fitted, strict=True)]
    measured = experiment(seed)
    return {
        "Table 1, ψ, sensor 1": np.array([_psi_of_table_2()]),
        "Table 2, C⁻¹": inv(errors.measurement)[:, *_UPPER],
        "Table 2, b": to_nanotesla(errors.bias_T),
        "Table 2, R": np.swapaxes(errors.rotation[1:], 1, 2),
        "Section 4.1, TMI": to_nanotesla(intensity_rms_T(fields, cases[0].intensity_T)),
        "Table 3, actual": np.array([tensor_nT_per_m(case.recording.readings_T, _BASELINE_M) for case in cases]),
        "Table 3, calibrated": np.array([tensor_nT_per_m(each, _BASELINE_M) for each in restored]),
        _FRAME: to_degrees(aligned_angles(fields[:, 0], cases[0].field_T)),
        right_name(_FRAME): to_degrees(true_errors(angles).misalignment[0]),
        "Table 4, calibrated": tensor_nT_per_m(
            calibrate(measured).restore(measured.recording.readings_T), measured.baseline_m
        ),
    }


def calibrate(case: SetUp) -> SensorErrors:
    """Return the errors that the paper's method finds, which uses no attitude."""
    return integrated(replace(case.recording, attitude=None), case.array).errors


def tensor_nT_per_m(fields_T: FloatArray, baseline_m: float) -> FloatArray:
    """Return the (5,) root mean square components xx, xy (along y), xz, yy, yz, nT/m."""
    return to_nanotesla(tensor_rms_T_per_m(fields_T, baseline_m))[[0, 1, 2, 4, 5]]


def _psi_of_table_2() -> float:
    """Return the ψ of sensor 1 with which the errors of Table 1 come nearest to its C⁻¹ in Table 2, radians."""
    from scipy.optimize import minimize_scalar

    printed = np.array(_PRINTED["unmix"][0])

    def misfit(psi: float) -> float:
        return float(norm(inv(true_errors(_with_psi(psi)).measurement[0])[_UPPER] - printed))

    return float(minimize_scalar(misfit, bounds=(-0.1, 0.1), method="bounded").x)
