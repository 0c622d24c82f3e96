"""The cases of the localisation benchmark in which the array or the source is calibrated or demodulated."""

from collections.abc import Iterable

import numpy as np
from asked import ANYTHING, Figure
from localization_setup import (
    AMPLITUDE_NOISE_T,
    ARRAY,
    MOMENT_AM2,
    POSES,
    SENSOR_NOISE_T,
    directions,
    ratio,
)
from numpy.linalg import inv
from rich.progress import track
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from tam_calibration.fit.source_calibration import SourceCalibration, calibrate_by_source
from tam_calibration.model.mounting import rotation_matrix
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation.conditions import Manoeuvre
from tam_calibration.sources.demodulation import Stretch, background_of, demodulate, turning_of
from tam_calibration.sources.dipole import Loop
from tam_validation.papers.wu2025_coil import POSITION_M, RADIUS_M


def source_calibration(generator: np.random.Generator, runs: int) -> Iterable[Figure]:
    """Yield the errors of baseline scale, common rotation and places of the axes over the Cramér–Rao bound."""
    errors = read_scenario("wu_turntable").errors
    source = Loop(POSITION_M, MOMENT_AM2 * np.array([0.6, -0.6, 0.5291503]), RADIUS_M)
    fits = []
    for _ in track(range(runs), description="source"):
        truth = _faulty_array(generator)
        clean = np.einsum("kij,nkj->nki", errors.matrix, _elements(source, truth, errors))
        exactly = _by_source(clean, source, errors)
        fits.append(
            (exactly, _by_source(clean + AMPLITUDE_NOISE_T * generator.standard_normal(clean.shape), source, errors))
        )
    squares = [(noisy.parameters - true.parameters) ** 2 for true, noisy in fits]
    bounds = [np.diag(true.covariance) for true, _ in fits]
    case = "source calibration, 12 headings"
    for name, part in (
        ("baseline scale", slice(0, 1)),
        ("common rotation", slice(1, 4)),
        ("places of the axes", slice(4, None)),
    ):
        ratios = [square[part].sum() / bound[part].sum() for square, bound in zip(squares, bounds, strict=True)]
        yield ratio(case, "calibrate_by_source", f"{name}, RMSE/bound", ratios, (0.0, 1.1))
    typical = np.sqrt(np.mean(bounds, axis=0))
    yield Figure(case, "bound", "baseline scale", float(typical[0]))
    yield Figure(case, "bound", "common rotation [rad]", float(typical[1:4].max()))
    yield Figure(case, "bound", "place of an axis, the worst [m]", float(typical[4:].max()))


def demodulation(generator: np.random.Generator, runs: int) -> Iterable[Figure]:
    """Yield the errors of amplitudes at 10 Hz over σ √(2/N), which takes phase and background for known."""
    time = np.arange(2000) / 100
    attitude = Manoeuvre(from_degrees(25), from_degrees(25), 20.0).attitudes(time, generator)
    background, turning = background_of(time, attitude), turning_of(attitude)[:, :3, :3]
    site = Rotation.from_quat(attitude).inv().apply(read_scenario("wu_turntable").site_field_T)
    drift = np.outer(np.sin(2 * np.pi * time / 300), from_nanotesla(np.array([8.0, 5.0, -6.0])))
    carrier = np.sin(2 * np.pi * 10 * (time - time[[0, -1]].mean()) + 0.4)[:, None]
    bound = SENSOR_NOISE_T * np.sqrt(2 / len(time))
    ratios: dict[tuple[str, str], list[float]] = {}
    for _ in track(range(runs), description="demodulation"):
        amplitude = from_nanotesla(np.array(generator.uniform(10, 1000))) * directions(generator, 1)[0]
        for rests, signal in (("array", carrier * amplitude), ("world", carrier * (turning @ amplitude))):
            noisy = site + drift + signal + SENSOR_NOISE_T * generator.standard_normal(signal.shape)
            heard = Stretch(time, noisy, background, turning if rests == "world" else None)
            found = demodulate(heard, 10.0).amplitude
            ratios.setdefault((rests, "synchronous least squares"), []).append(_square(found, amplitude, bound))
            if rests == "array":
                passed = band_pass_amplitude(time, noisy)
                ratios.setdefault((rests, "band-pass 8 to 12 Hz"), []).append(_square(passed, amplitude, bound))
    for (rests, method), squares in ratios.items():
        case = f"10 Hz, 20 s, 1 nT, platform turns, source rests in the {rests}"
        asked = (0.0, 1.05) if method.startswith("synchronous") else ANYTHING
        yield ratio(case, method, "amplitude, RMSE/bound", squares, asked)


def band_pass_amplitude(time_s: FloatArray, channels: FloatArray) -> FloatArray:
    """Return the signed amplitudes (D,) of channels (N, D) behind a band-pass of 8 to 12 Hz, as Wu 2025 takes them.

    A Butterworth filter of second order runs forwards and backwards; the amplitude is √2 times the root mean square of
    the middle half, in which the filter has settled, and its sign that of the correlation with the strongest channel.
    """
    sections = butter(2, (8, 12), btype="bandpass", fs=1 / float(np.diff(time_s).mean()), output="sos")
    passed = sosfiltfilt(sections, channels, axis=0)[len(time_s) // 4 : 3 * len(time_s) // 4]
    size = np.sqrt(2 * np.mean(passed**2, axis=0))
    return np.asarray(size * np.sign(passed.T @ passed[:, size.argmax()]))


def _faulty_array(generator: np.random.Generator) -> SourceCalibration:
    """Return baselines wrong by 3 %, a frame turned by half a degree, and axes 5 mm from their places, at random."""
    scale, rotation = 1 + 0.03 * generator.standard_normal(), from_degrees(0.5 * generator.standard_normal(3))
    return SourceCalibration(scale, rotation, 5e-3 * generator.standard_normal((4, 3, 3)), np.zeros((40, 40)), 0.0, 0)


def _elements(source: Loop, truth: SourceCalibration, errors: SensorErrors) -> FloatArray:
    """Return (12, 4, 3) numbers that the matrices of the errors turn into what the displaced elements read."""
    turn, array = POSES.as_matrix(), truth.array_of(ARRAY.with_stated_noise())
    world = source.field_T(np.einsum("nij,kaj->nkai", turn, array.element_positions_m))
    rows = errors.matrix @ rotation_matrix(truth.rotation)
    raw = np.einsum("kai,nji,nkaj->nka", rows, turn, world, optimize=True)
    undone: FloatArray = np.einsum("kij,nkj->nki", inv(errors.matrix), raw)
    return undone


def _by_source(amplitudes_T: FloatArray, source: Loop, errors: SensorErrors) -> SourceCalibration:
    return calibrate_by_source(amplitudes_T, AMPLITUDE_NOISE_T, source, POSES.as_quat(), errors, ARRAY)


def _square(found: FloatArray, true: FloatArray, bound: float) -> float:
    """Return the mean squared error over the bound's, the sign of all channels together apart."""
    sign = np.sign(found @ true)
    return float(np.mean((sign * found - true) ** 2) / bound**2)
