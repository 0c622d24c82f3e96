"""Laws that predict nothing: noise, errors of time that tremble, spikes, and readings that are held or filled in."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.least_squares import ROUNDING
from tam_calibration.effects.grades import FEWEST, MINOR, NEARLY_ALL, NOTABLE
from tam_calibration.effects.recursions import lagged
from tam_calibration.effects.single_samples import A_DOZEN
from tam_calibration.gap.laws.decisions import COARSE, LEAST_EVIDENCE, SCATTER_SIZES, TOLERANCE
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
    scaled = residual.scaled(unit)
    judged = partial(_scatter, scaled, unit, whole)
    found = [judged(*place) for place in _places(scaled)]
    noisy = [one for one in found if one.law in ("noise", "samples") and len(one.axes) == 3]
    noisy = sorted(noisy, key=lambda one: -one.evidence)
    for count in range(2, len(noisy) + 1):
        several = tuple(sorted((one.sensors[0] for one in noisy[:count]), key=str))
        found.append(judged("noise", several, tuple(AXES), _shifts(scaled, several, tuple(AXES))))
        if found[-1].evidence < noisy[0].evidence:
            break
    common = max(_widened(_of_sizes(*_resolved(scaled.response[:, :, :-1], scaled))), 0.0)
    found = [replace(one, evidence=one.evidence - common) for one in found]
    return sorted((one for one in found if one.evidence > LEAST_EVIDENCE), key=lambda one: -one.evidence)


def _scatter(
    residual: Residual,
    unit: float,
    whole: float,
    law: str,
    sensors: Place,
    axes: tuple[str, ...],
    columns: FloatArray,
) -> Signature:
    """Return what scatter in the columns (N, C, p) of a place explains of a gap, as a law."""
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
    return Signature(law, course, sensors, axes, energy, (sensors,), None, (), evidence)


def _shifts(residual: Residual, place: Place, axes: tuple[str, ...]) -> FloatArray:
    """Return what shifts of axes of sensors, or of the scalar, add to the channels (N, C, p)."""
    rows = [sensor_rows(int(one))[AXES.index(axis)] for one in place if one != "scalar" for axis in axes]
    return np.asarray(residual.response[:, :, rows or [-1]])


def _places(residual: Residual) -> Iterator[tuple[str, Place, tuple[str, ...], FloatArray]]:
    """Yield laws of scatter with their places and columns (N, C, p)."""
    for sensor in range(1, residual.sensor_count + 1):
        rows = sensor_rows(sensor)
        response = residual.response[:, :, rows]
        late = response * residual.sensed_rate[:, None, rows]
        yield "noise", (sensor,), tuple(AXES), response
        yield "rate", (sensor,), tuple(AXES), late.sum(axis=2, keepdims=True)
        yield "gain", (sensor,), tuple(AXES), response @ residual.own[:, rows, None]
        for axis, name in enumerate(AXES):
            yield "noise", (sensor,), (name,), response[:, :, axis : axis + 1]
            yield "rate", (sensor,), (name,), late[:, :, axis : axis + 1]
    yield "noise", ("scalar",), (), residual.response[:, :, -1:]


def noise_follows(residual: Residual, place: Place, axes: tuple[str, ...]) -> str | None:
    """Return what the size of noise at a place follows: "motion", a recorded channel, or None.

    Score tests of variances are compared. Some follow the square of a component of the field or of the rate of turning.
    Two follow the rate some samples later, as what rings or settles does. Others follow a channel or its square. The
    last has a value for each part of the time.
    """
    values, along = _resolved(_shifts(residual, place, axes), residual)
    rank = (along**2 / np.maximum(values, ROUNDING)).sum(axis=1).argsort().argsort()
    energy = -1 - np.log(1 - (rank + 0.5) / residual.count)  # with one distribution, whatever that of the noise
    directions, step_s = _spread_directions(64), float(np.median(np.diff(residual.time_s)))
    after = [lagged((residual.turning**2).sum(axis=1), residual.time_s, part * step_s) for part in (4.0, 16.0)]
    drives = {
        "motion": np.column_stack([(residual.field @ directions) ** 2, (residual.turning @ directions) ** 2, *after])
    }
    drives |= {name: np.column_stack([one, one**2]) for name, one in residual.channels.items()}
    penalty, parts = 0.5 * np.log(residual.count), np.array_split(energy, COARSE // 2)
    of_time = 0.5 * sum(one.sum() ** 2 / len(one) for one in parts) - (len(parts) - 1) * penalty
    evidence = {}
    for name, drive in drives.items():
        standard = (drive - drive.mean(axis=0)) / np.maximum(drive.std(axis=0), ROUNDING)
        evidence[name] = 0.5 * np.max((standard.T @ energy) ** 2) / residual.count - np.log(drive.shape[1]) - penalty
    best = max(evidence, key=lambda name: evidence[name])
    return best if evidence[best] > max(of_time, 0.0) + LEAST_EVIDENCE else None


def _spread_directions(count: int) -> FloatArray:
    """Return unit vectors (3, count) that are spread evenly over half of the sphere, along a spiral."""
    height = np.arange(0.5, count) / count
    around, angle = np.sqrt(1 - height**2), np.arange(count) * np.pi * (np.sqrt(5) - 1)
    return np.array([around * np.cos(angle), around * np.sin(angle), height])


def _resolved(columns: FloatArray, residual: Residual) -> tuple[FloatArray, FloatArray]:
    """Return the information (N, p) and the score (N, p) along the principal directions of each sample."""
    turned = np.swapaxes(columns, 1, 2)
    information = turned @ columns
    score = (turned @ residual.z[:, :, None])[:, :, 0]
    if columns.shape[2] == 1:
        return information[:, 0], score
    values, vectors = np.linalg.eigh(information)
    values = np.maximum(values, 0)
    return values, (np.swapaxes(vectors, 1, 2) @ score[:, :, None])[:, :, 0]


def _of_sizes(values: FloatArray, along: FloatArray) -> FloatArray:
    """Return the log likelihood ratio (S, N) of further variance of each size."""
    mean = max(float(values.mean()), 1e-300)
    sizes = SCATTER_SIZES / mean
    weighed = 1 + sizes[:, None, None] * values
    return np.asarray(0.5 * ((sizes[:, None, None] * along**2 / weighed).sum(axis=2) - np.log(weighed.prod(axis=2))))


def _widened(of_sizes: FloatArray) -> float:
    """Return the evidence of noise that is larger throughout, from the ratios (S, N) of sizes."""
    return float(of_sizes.sum(axis=1).max() - np.log(of_sizes.shape[1]))


def _sparse(of_sizes: FloatArray) -> tuple[float, float, FloatArray]:
    """Return the evidence of large deviations in some samples, how many, and the probability (N,) of each."""
    ratios = of_sizes[::2]
    odds = np.exp(-np.maximum(ratios, -500))
    part = np.full((len(ratios), 1), 0.02)
    for _ in range(10):
        often = 1 / (1 + (1 - part) / part * odds)
        part = np.clip(often.mean(axis=1, keepdims=True), 1e-4, 0.4)
    likelihood = np.maximum(ratios, -500) + np.log(part + (1 - part) * odds)
    total = likelihood.sum(axis=1) - 1.5 * np.log(ratios.shape[1])
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


def law_of(rest: Residual, chosen: NDArray[np.bool_]) -> tuple[str, Place, tuple[str, ...]]:
    """Return the law of some samples (N,), and the sensors and axes whose shifts explain most of them, the fewest.

    Where not even several sensors explain them, all may be off. Where all axes of a sensor are off along the rate of
    change of the field, its time is off.
    """
    struck = replace(rest, z=rest.z[chosen], seen=replace(rest.seen, shifts=rest.seen.shifts[chosen]))

    def energy(columns: FloatArray) -> float:
        """Return the energy that free shifts along columns of the chosen samples explain."""
        values, along = _resolved(columns, struck)
        seen = values > 1e-9 * max(values.max(), 1e-300)
        return float((along**2 / np.where(seen, values, np.inf)).sum())

    def energy_at(place: Place) -> float:
        """Return the energy that free shifts of all axes of some sensors explain."""
        return energy(_shifts(struck, place, tuple(AXES)))

    explained = {place[:3]: energy(place[3][chosen]) for place in _places(rest) if place[0] in ("noise", "rate")}
    noise = {key[1:]: value for key, value in explained.items() if key[0] == "noise"}
    least = NEARLY_ALL * max(noise.values())
    sensors, axes = min((key for key in noise if noise[key] > least), key=lambda key: len(key[1]))
    beyond_noise = float((rest.z[chosen] ** 2).sum()) - chosen.sum() * rest.z.shape[1]
    if noise[sensors, axes] < (1 - NOTABLE) * beyond_noise:
        every = tuple(range(1, rest.sensor_count + 1))
        found: Place = max(combinations(every, 2), key=energy_at, default=every)
        # What all sensors have, all but one can have as well: only differences between them are seen.
        while found != every and (len(found) > len(every) - 2 or energy_at(found) < (1 - TOLERANCE**2) * beyond_noise):
            found = max((tuple(sorted({*found, one})) for one in every if one not in found), key=energy_at)
        return "samples", found, tuple(AXES)
    along_rate = explained.get(("rate", sensors, axes), 0.0) if len(axes) == 3 and chosen.sum() >= FEWEST else 0.0
    return "rate" if along_rate > (1 - MINOR) * noise[sensors, axes] else "samples", sensors, axes
