"""The places in which a law may sit, and the evidence of which of them it does.

A place can make a law if free shifts of what it shifts, sample by sample, make the same residual: what the scalar shows
alone, a field at all sensors alike does as well, and what turns all sensors together, an error of the attitude. Scalar
and field are compared by the likelihood of the scalar's own readings s and of the intensity at the array b = s - x,
with x the residual between them, in octaves of a cosine transform, the calibration eliminated. With φ the power of a
field that both feel and ψ that of the disturbance, the covariance of (s, b) is φ + diag(σ² + ψ, τ²) if the scalar
is disturbed, and φ + diag(σ², τ² + ψ) if the array is. Where the attitude was recorded, the direction of the field in
the world tells as well: no error of the scalar turns it.
"""

import numpy as np

from tam_calibration.effects.grades import LEAST_SAMPLES, SLIGHT
from tam_calibration.gap.laws.decisions import SCATTER_SIZES, TIE, TOLERANCE
from tam_calibration.gap.laws.law import ATTITUDE, SCALAR, Place
from tam_calibration.gap.laws.whitened import Residual
from tam_calibration.model.units import FloatArray


def places_of(place: Place, signal: FloatArray, residual: Residual) -> tuple[Place, ...]:
    """Return the places that can make a law, the likeliest first.

    Parameters
    ----------
    place : tuple
        Where it was found.
    signal : (N, C) array
        What it adds to the channels.
    residual : Residual
        With the law in it, without those found before.
    """
    every = tuple(range(1, residual.sensor_count + 1))
    if place not in (SCALAR, every):
        return (place,)
    others = [one for one in (SCALAR, every)[residual.sensor_count == 1 :] if one != place]
    others += [] if residual.model.world is None else [ATTITUDE]
    rest = {one: signal - within(residual, one, signal) for one in others}
    possible = [one for one in others if (rest[one] ** 2).sum() < TOLERANCE**2 * (signal**2).sum()]
    if not {SCALAR, every} <= {place, *possible}:
        return place, *possible
    if residual.model.recording.scalar_T is None:
        return (every,)
    odds = field_over_scalar(residual)
    ranked = (every, SCALAR) if odds > 0 else (SCALAR, every)
    is_decided = residual.rotation is not None and abs(odds) > TIE
    return ranked[:1] if is_decided else ranked


def within(residual: Residual, place: Place, signal: FloatArray) -> FloatArray:
    """Return the part of a signal (N, C) that free shifts of a place in each sample make."""
    sensors: FloatArray = residual.response[:, :, :-1]
    if place == SCALAR:
        columns = residual.response[:, :, -1:]
    elif place == ATTITUDE:
        turned = np.cross(np.eye(3)[None], residual.field[:, None])
        columns = sensors @ np.einsum("rj,naj->nra", residual.matrix, turned)
    else:
        columns = sensors @ residual.matrix
    back = np.swapaxes(columns, 1, 2)
    return np.asarray((columns @ (np.linalg.pinv(back @ columns, rcond=1e-6) @ (back @ signal[:, :, None])))[:, :, 0])


def field_over_scalar(residual: Residual) -> float:
    """Return the log odds of a field at the array over a fault of the scalar; 0 with few readings of the scalar."""
    slope = residual.response[:, -1, -1]
    known = residual.live & (slope > 0)
    scalar_T = residual.model.recording.scalar_T
    if scalar_T is None or known.sum() < LEAST_SAMPLES:
        return 0.0
    x = residual.z[known, -1] / slope[known]
    scalar = scalar_T[residual.index[known]] / residual.unit_T
    unit = residual.field[known]
    squares = unit[:, [0, 0, 0, 1, 1]] * unit[:, [0, 1, 2, 1, 2]]
    calibration = np.column_stack([np.ones(len(unit)), unit, squares])
    variance = residual.noise * float(np.mean(1 / slope[known] ** 2))
    own = min((residual.model.array.scalar_noise_T / residual.unit_T) ** 2, variance / 2)
    bands = _octaves(np.column_stack([_beside(scalar, calibration), _beside(x, calibration)]))
    excess = np.array([float((band[:, 1] ** 2).sum()) - len(band) * variance for band in bands])
    kept = [band for band, one in zip(bands, excess, strict=True) if one > SLIGHT * max(excess.sum(), 0)]
    odds = sum(_odds(band[:, 0], band[:, 0] - band[:, 1], own, variance - own) for band in kept)
    if residual.rotation is None:
        return odds
    turned = np.einsum("nij,nj->ni", residual.rotation[known], unit)
    mean = turned.mean(axis=0) / np.linalg.norm(turned.mean(axis=0))
    across = turned - (turned @ mean)[:, None] * mean
    return odds + _turning_odds(_beside(x, calibration), _beside(across, calibration))


def _beside(values: FloatArray, calibration: FloatArray) -> FloatArray:
    """Return values (N, ...) without what the calibration (N, q) explains."""
    return np.asarray(values - calibration @ np.linalg.lstsq(calibration, values, rcond=None)[0])


def _octaves(values: FloatArray) -> list[FloatArray]:
    """Return the cosine transform of courses (N, c) but for the mean, in octaves (n, c)."""
    from scipy.fft import dct

    edges = 2 ** np.arange(1, int(np.log2(len(values))) + 1)
    return np.split(dct(values, axis=0, norm="ortho")[1:], [edge - 1 for edge in edges if edge < len(values)])


def _odds(scalar: FloatArray, array: FloatArray, own: float, other: float) -> float:
    """Return the log odds of the array over the scalar in a band, each at the best powers of field and disturbance.

    Parameters
    ----------
    scalar, array : (n,) array
        Transforms of the scalar's readings and of the intensity at the array.
    own, other : float
        Variances of their noise.
    """
    squares, cross, count = (scalar @ scalar, array @ array), float(scalar @ array), len(scalar)
    powers = np.append(
        0.0, (own + other) * np.geomspace(SCATTER_SIZES.min(), SCATTER_SIZES.max(), 4 * len(SCATTER_SIZES))
    )
    shared, disturbed = np.meshgrid(powers, powers)
    best = []
    for more in ((disturbed, 0.0), (0.0, disturbed)):
        first, second = shared + own + more[0], shared + other + more[1]
        determinant = first * second - shared**2
        energy = (second * squares[0] + first * squares[1] - 2 * shared * cross) / determinant
        best.append(float((-0.5 * (count * np.log(determinant) + energy)).max()))
    return best[1] - best[0]


def _turning_odds(x: FloatArray, across: FloatArray) -> float:
    """Return the log odds that the direction of the field goes with the residual: fitted to half, judged on the other.

    Parameters
    ----------
    x : (N,) array
        Residual of the intensity.
    across : (N, 3) array
        Direction of the field in the world, across its mean.
    """
    odds = 0.0
    bands = [band / np.sqrt((band[:, 1:] ** 2).mean()) for band in _octaves(np.column_stack([x, across]))]
    orders = np.concatenate([np.arange(len(band)) + len(band) - 1 for band in bands])
    joined = np.concatenate(bands)
    for parity in (0, 1):
        fitted, judged = joined[orders % 2 == parity], joined[orders % 2 != parity]
        slope = fitted[:, 0] @ fitted[:, 1:] / max(float(fitted[:, 0] @ fitted[:, 0]), np.finfo(float).tiny)
        odds += float((judged[:, 1:] ** 2).sum() - ((judged[:, 1:] - np.outer(judged[:, 0], slope)) ** 2).sum()) / 4
    return max(odds, 0.0)
