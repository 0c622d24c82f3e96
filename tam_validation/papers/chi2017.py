"""The simulation of Chi 2017: 200 attitudes in 50 000 nT with hard and soft iron, Tables 2 and 3.

ψ of sensor 1 must be -0.025 where Table 1 prints +0.025: then Table 2 comes out. The attitudes are not printed; they
are drawn here from uniform angles. What is measured is in the file of what it prints.
"""

from dataclasses import replace

import numpy as np
from numpy.linalg import inv, norm

from tam_calibration.fit.integrated import integrated
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_nanotesla, to_degrees, to_nanotesla
from tam_validation.papers.cross import SENSORS, SetUp, site_field
from tam_validation.papers.printed import finding, printed_in
from tam_validation.papers.row import PaperNumber, compare

_BASELINE_M = 0.5
_SAMPLES = 200
_VARIANCES_NT2 = (9, 12, 15)

_PRINTED = printed_in("chi2017")
NON_ORTHOGONALITY = np.array(_PRINTED["non_orthogonality"])
"""θ, φ, ψ of the sensors [rad]; ψ of sensor 1 with its sign mended."""
_UNMIX, _ROTATION = np.array(_PRINTED["unmix"]), np.array(_PRINTED["rotation"])
COMBINED_BIAS_NT = np.array(_PRINTED["combined_bias_nT"])
_COMPONENTS = ("Bxx", "Bxy", "Bxz", "Byy", "Byz")


def set_up(variance_nT2: float = 9.0, seed: int = 0) -> SetUp:
    """Return the cross of Table 1 and its readings, with the attitude of the platform.

    Parameters
    ----------
    variance_nT2 : float
        Variance of the noise of each axis, nT².
    seed : int
        Of the random attitudes and noise.
    """
    from scipy.spatial.transform import Rotation

    generator = np.random.default_rng(seed)
    site = site_field(from_nanotesla(50_000.0), 55.0, -7.0)
    attitude = Rotation.from_euler("XYZ", generator.uniform(0, 2 * np.pi, (_SAMPLES, 3))).inv()
    field = attitude.inv().apply(site)
    errors = true_errors()
    noise = from_nanotesla(np.sqrt(variance_nT2)) * generator.normal(size=(_SAMPLES, 4, 3))
    intensity = np.full(_SAMPLES, float(np.linalg.norm(site)))
    recording = Recording(
        np.arange(float(_SAMPLES)), errors.distort(field) + noise, intensity, attitude=attitude.as_quat()
    )
    array = Array.cross(_BASELINE_M, from_nanotesla(float(np.sqrt(variance_nT2))), 0.0)
    return SetUp(array, _BASELINE_M, errors, field, recording)


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


def results() -> list[PaperNumber]:
    """Return the numbers of Tables 1 to 3 and of section 4.1 that the simulation gives, the paper's beside ours."""
    cases = [set_up(variance) for variance in _VARIANCES_NT2]
    fitted = [integrated(replace(case.recording, attitude=None), case.array).errors for case in cases]
    return [
        *_matrix_rows(fitted[0]),
        *_intensity_rows(cases[0], fitted[0]),
        *_tensor_rows(cases, fitted),
        *_frame_rows(cases[0]),
    ]


def _matrix_rows(errors: SensorErrors) -> list[PaperNumber]:
    rows = finding("chi2017", "psi", [_psi_of_table_2()])
    upper = np.triu_indices(3)
    unmix = inv(errors.measurement)
    for sensor, name in enumerate(SENSORS):
        elements = [f"Table 2, C⁻¹ {row + 1}{column + 1}, {name}" for row, column in zip(*upper, strict=True)]
        rows += compare(elements, _UNMIX[sensor][upper].tolist(), unmix[sensor][upper], "1", absolute=2e-4)
        biases = [f"Table 2, b {axis}, {name}" for axis in "xyz"]
        rows += compare(
            biases, COMBINED_BIAS_NT[sensor].tolist(), to_nanotesla(errors.bias_T[sensor]), "nT", absolute=2
        )
    for sensor in range(1, 4):
        elements = [f"Table 2, R {row}{column}, {SENSORS[sensor]}" for row in (1, 2, 3) for column in (1, 2, 3)]
        ours = errors.rotation[sensor].T.ravel()
        rows += compare(elements, _ROTATION[sensor - 1].ravel().tolist(), ours, "1", absolute=2e-4)
    return rows


def _psi_of_table_2() -> float:
    """Return the ψ of sensor 1 with which the errors of Table 1 come nearest to its C⁻¹ in Table 2, radians."""
    from scipy.optimize import minimize_scalar

    def misfit(psi: float) -> float:
        angles = NON_ORTHOGONALITY.copy()
        angles[0, 2] = psi
        return float(norm(inv(true_errors(angles).measurement[0]) - _UNMIX[0]))

    return float(minimize_scalar(misfit, bounds=(-0.1, 0.1), method="bounded").x)


def _intensity_rows(case: SetUp, errors: SensorErrors) -> list[PaperNumber]:
    names = [f"Section 4.1, TMI, {sensor}" for sensor in SENSORS]
    ours = to_nanotesla(case.intensity_rms_T(errors.restore(case.recording.readings_T)))
    # Four times the sampling error of a root mean square of 200 draws.
    return compare(names, _PRINTED["intensity_nT"], ours, "nT", relative=0.2)


def _tensor_rows(cases: list[SetUp], fitted: list[SensorErrors]) -> list[PaperNumber]:
    rows = []
    for variance, case, errors, before, after in zip(
        _VARIANCES_NT2, cases, fitted, _PRINTED["tensor_before"], _PRINTED["tensor_after"], strict=True
    ):
        raw = _tensor(case, case.recording.readings_T)
        corrected = _tensor(case, errors.restore(case.recording.readings_T))
        names = [f"Table 3, {component}, actual, {variance} nT²" for component in _COMPONENTS]
        rows += finding("chi2017", "tensor", raw, names=names, paper=before)
        names = [f"Table 3, {component}, calibrated, {variance} nT²" for component in _COMPONENTS]
        rows += compare(names, after, corrected, "nT/m", relative=0.2)
    return rows


def _tensor(case: SetUp, fields_T: FloatArray) -> FloatArray:
    """Return the (5,) components xx, xy (along y), xz, yy, yz, nT/m."""
    return to_nanotesla(case.tensor_rms_T_per_m(fields_T))[[0, 1, 2, 4, 5]]


def _frame_rows(case: SetUp) -> list[PaperNumber]:
    return finding("chi2017", "frame", to_degrees(case.errors.misalignment[0]))
