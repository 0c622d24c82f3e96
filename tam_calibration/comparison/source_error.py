"""What the mission needs: how far from a source that is put into a recording it is located."""

from dataclasses import replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.comparison.result import Side, SourceError
from tam_calibration.localization.sample_by_sample import Regional, locate_samples, regional_of, turned
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.dipole import Dipole

_DISTANCE = 8.0
"""Distance of the source, in those of the farthest sensor from the centre: 2 m for a cross of 0.5 m."""

_DIRECTION = np.array([0.6, 0.48, -0.64])
"""Of the source from the array in the world, as of an object on the ground ahead."""

_SIGNAL = 300.0
"""Gradient of the source over the standard error of the tensor's components: found to about a tenth of a per cent."""

_MOST = 400
"""Samples that are located: enough for a median within a tenth of its size."""

_BLOCKS = 20
"""Blocks of time whose medians tell how certain the median of all is."""

_DRAWS = 1000
"""Times that blocks are drawn anew (bootstrap)."""


def source_of(side: Side) -> Dipole | None:
    """Return the source that is put into both recordings, for the noise of one; None where no gradient is known.

    Parameters
    ----------
    side : Side
        The recording.
    """
    array = side.calibration.array
    if not array.has_gradient or side.recording.attitude is None:
        return None
    distance = _DISTANCE * float(norm(array.positions_m, axis=1).max())
    error = float(np.sqrt(np.mean(side.calibration.output_standard_errors[3:] ** 2)))
    # The largest component of the gradient of a dipole is 6 x 10⁻⁷ m / r⁴.
    moment = _SIGNAL * error * distance**4 / 6e-7
    return Dipole(distance * _DIRECTION, moment * np.array([0.0, 0.6, 0.8]))


def source_error(recording: Recording, side: Side, source: Dipole) -> SourceError | None:
    """Return how far from a source beside the array its samples place it in a recording; None where they cannot.

    What ``tam locate`` would refuse, as the effects leave more than noise, counts too: how far off it is, is asked.

    Parameters
    ----------
    recording : Recording
        Raw readings (N, K, 3), tesla, with attitude.
    side : Side
        Whose calibration, without the effects, is used: that of a mission that does not know of them.
    source : Dipole
        In the world, from the array's centre.
    """
    from scipy.spatial.transform import Rotation

    if recording.attitude is None:
        return None
    calibration = replace(side.calibration, effects=(), effect_sizes=())
    known = np.flatnonzero(np.isfinite(recording.attitude).all(axis=1))
    chosen = recording.take(known[np.linspace(0, len(known) - 1, min(_MOST, len(known))).astype(int)])
    assert chosen.attitude is not None
    regional = Regional(regional_of(calibration.correct(chosen).outputs, chosen.attitude).field_T)
    turns = Rotation.from_quat(chosen.attitude).as_matrix()
    world = source.field_T(np.einsum("nij,kj->nki", turns, calibration.array.positions_m))
    in_array = np.einsum("nji,nkj->nki", turns, world)
    added = np.einsum("kij,nkj->nki", calibration.errors.matrix, in_array)
    outputs = calibration.correct(replace(chosen, readings_T=chosen.readings_T + added)).outputs
    in_array_m = locate_samples(
        outputs, calibration.array, calibration.output_covariance, regional=regional, attitude=chosen.attitude
    )
    distance = norm(turned(in_array_m, chosen.attitude).position_m - source.position_m, axis=1)
    return _error(distance) if np.isfinite(distance).mean() > 0.5 else None


def _error(distance_m: FloatArray) -> SourceError:
    """Return the median of distances (N,), with the interval that the medians of blocks of time give."""
    generator = np.random.default_rng(0)
    blocks = np.array([np.nanmedian(block) for block in np.array_split(distance_m, _BLOCKS)])
    drawn = np.median(generator.choice(blocks[np.isfinite(blocks)], (_DRAWS, _BLOCKS)), axis=1)
    low, high = np.quantile(drawn, (0.025, 0.975))
    return SourceError(float(np.nanmedian(distance_m)), (float(low), float(high)))
