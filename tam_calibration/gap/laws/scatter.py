"""Laws that predict nothing: noise, errors of time that tremble, spikes, and readings that are held or filled in."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.grades import MINOR, NEARLY_ALL, NOTABLE
from tam_calibration.effects.outliers import A_DOZEN
from tam_calibration.gap.laws.decisions import LEAST_EVIDENCE, SCATTER_SIZES, TOLERANCE
from tam_calibration.gap.laws.law import Place, Signature
from tam_calibration.gap.laws.patterns import AXES, sensor_rows
from tam_calibration.gap.laws.whitened import Residual
from tam_calibration.model.units import FloatArray


def scatter_of(residual: Residual, whole: float) -> list[Signature]:
    """Return the laws of scatter that explain the residual, the best first; those of evidence only.

    Parameters
    ----------
    residual : Residual
        What the other laws leave.
    whole : float
        Energy of the gap, in units of the noise.
    """
    left = float((residual.z**2).sum() - residual.size)
    # Noise, and the error of any law of the residual's size.
    unit = float(np.sqrt(1 + TOLERANCE**2 * max(left, 0.0) / residual.size))
    residual = residual.scaled(unit)
    common = _widened(_of_sizes(*_resolved(residual.response[:, :, :-1], residual)))
    found = []
    for law, sensors, axes, columns in _places(residual):
        values, along = _resolved(columns, residual)
        of_sizes = _of_sizes(values, along)
        evidence = _widened(of_sizes)
        sparse, share, often = _sparse(of_sizes)
        explained = unit**2 * (along**2 / np.maximum(values, 1e-12)).sum() - (values > 1e-9).sum()
        course = "random"
        is_rare = share < MINOR  # deviations of single samples, and not spans of noise
        if sparse > evidence + LEAST_EVIDENCE and not (is_rare and law == "rate"):
            evidence = sparse
            if is_rare and law == "noise":
                law = "samples"
            elif often.std() > 0 and np.corrcoef(often[1:], often[:-1])[0, 1] > NOTABLE:
                course = "episodes"
        energy = float(np.clip(explained / whole, 0, 1))
        beyond = evidence - max(common, 0.0)
        found.append(Signature(law, course, sensors, axes, energy, (sensors,), None, (), beyond))
    return sorted((one for one in found if one.evidence > LEAST_EVIDENCE), key=lambda one: -one.evidence)


def _places(residual: Residual) -> Iterator[tuple[str, Place, tuple[str, ...], FloatArray]]:
    """Yield laws of scatter with their places and columns (N, C, p)."""
    for sensor in range(1, residual.sensor_count + 1):
        rows = sensor_rows(sensor)
        response = residual.response[:, :, rows]
        yield "noise", (sensor,), tuple(AXES), response
        for axis in range(3):
            yield "noise", (sensor,), (AXES[axis],), response[:, :, axis : axis + 1]
        rate = residual.sensed_rate[:, rows]
        yield "rate", (sensor,), tuple(AXES), response @ rate[:, :, None]
        for axis in range(3):
            yield "rate", (sensor,), (AXES[axis],), response[:, :, axis : axis + 1] * rate[:, None, axis : axis + 1]
    yield "noise", ("scalar",), (), residual.response[:, :, -1:]


def _resolved(columns: FloatArray, residual: Residual) -> tuple[FloatArray, FloatArray]:
    """Return the information (N, p) and the score (N, p) along the principal directions of each sample."""
    turned = np.swapaxes(columns, 1, 2)
    information = turned @ columns
    score = (turned @ residual.z[:, :, None])[:, :, 0]
    values, vectors = np.linalg.eigh(information)
    values = np.maximum(values, 0)
    return values, (np.swapaxes(vectors, 1, 2) @ score[:, :, None])[:, :, 0]


def _of_sizes(values: FloatArray, along: FloatArray) -> FloatArray:
    """Return the log likelihood ratio (S, N) of further variance of each size."""
    mean = max(float(values.mean()), 1e-300)
    sizes = SCATTER_SIZES / mean
    weighed = 1 + sizes[:, None, None] * values
    return np.asarray(0.5 * (sizes[:, None, None] * along**2 / weighed - np.log(weighed)).sum(axis=2))


def _widened(of_sizes: FloatArray) -> float:
    """Return the evidence of noise that is larger throughout, from the ratios (S, N) of sizes."""
    return float(of_sizes.sum(axis=1).max() - np.log(of_sizes.shape[1]))


def _sparse(of_sizes: FloatArray) -> tuple[float, float, FloatArray]:
    """Return the evidence of large deviations in some samples, how many, and the probability (N,) of each."""
    ratios = of_sizes[::2]
    odds = np.exp(-np.clip(ratios, -500, 500))
    part = np.full((len(ratios), 1), 0.02)
    for _ in range(10):
        often = 1 / (1 + (1 - part) / part * odds)
        part = np.clip(often.mean(axis=1, keepdims=True), 1e-4, 0.4)
    total = np.logaddexp(np.log1p(-part), np.log(part) + ratios).sum(axis=1) - 1.5 * np.log(ratios.shape[1])
    best = int(total.argmax())
    return float(total[best]), float(part[best, 0]), often[best]


def spikes(residual: Residual) -> NDArray[np.bool_]:
    """Return which samples (N,) lie far from their neighbours; none where many do."""
    energy = (residual.z**2).sum(axis=1)
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(energy, 5, mode="reflect"), 11)
    middle = np.median(windows, axis=1)
    width = residual.z.shape[1]
    # Noise lies six standard deviations off once in 10⁹ samples. What lasts more than three samples is an episode.
    found = energy > np.maximum(width + 6.0**2, 6.0 * middle)
    beside = np.convolve(found, np.ones(7), mode="same") > 3
    found &= ~beside
    return found if found.sum() <= max(MINOR * len(found), A_DOZEN) else np.zeros(len(found), dtype=bool)


def repeated(readings: FloatArray) -> NDArray[np.bool_]:
    """Return which samples (N, K) of sensors repeat their last reading in all axes, or lie on a line between others.

    Parameters
    ----------
    readings : (N, K, 3) array
        In any unit.
    """
    change = np.diff(readings, axis=0)
    usual = np.maximum(np.median(np.abs(change), axis=0), 1e-300)
    held = np.zeros(readings.shape[:2], dtype=bool)
    same = (np.abs(change) <= 1e-6 * usual).all(axis=2)
    held[1:] |= same
    bend = np.abs(np.diff(change, axis=0))
    on_line = (bend <= 1e-3 * usual).all(axis=2)
    held[1:-1] |= on_line & ~same[1:]
    return held


def place_of(rest: Residual, chosen: NDArray[np.bool_]) -> tuple[Place, tuple[str, ...]]:
    """Return the sensors and axes whose shifts explain most of some samples (N,), the fewest that do."""
    energies = []
    for law, sensors, axes, columns in _places(rest):
        if law == "noise":
            values, along = _resolved(columns[chosen], replace(rest, z=rest.z[chosen]))
            seen = values > 1e-9 * max(values.max(), 1e-300)
            explained = (along**2 / np.where(seen, values, np.inf)).sum()
            energies.append((explained, -columns.shape[2], sensors, axes))
    best = max(energies, key=lambda one: one[0])[0]
    _, _, sensors, axes = max((one for one in energies if one[0] > NEARLY_ALL * best), key=lambda one: one[1])
    return sensors, axes
