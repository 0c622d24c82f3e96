"""The mend of a simulation, and the twin of its run with the mend in it.

What the mission needs measures how much it helps: how far from an added source ``tam locate`` would find it.
"""

from dataclasses import replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.comparison.additions import mended
from tam_calibration.comparison.agreement import is_noise
from tam_calibration.comparison.differences import Differences
from tam_calibration.comparison.mend import Mend, NoiseTerm
from tam_calibration.comparison.result import NoiseDifference, SourceError
from tam_calibration.comparison.side import Side
from tam_calibration.effects.states import WINDOW_UNITS
from tam_calibration.gap.noise import field_of
from tam_calibration.localization.turned_samples import Regional, Samples, locate_each, regional_of, turned
from tam_calibration.model.fitted_effect import FittedEffect
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.dipole import Dipole

_TIMES = {"time_s", "end_s", "start_s", *WINDOW_UNITS}
"""Parameters of shapes that are times of a recording, and not durations."""


def mend_of(differences: Differences, simulation: Side, recording: Side) -> Mend:
    """Return what to write into the simulator.

    Parameters
    ----------
    differences : Differences
        Between the two.
    simulation, recording : Side
        The two.
    """
    added = [one.fitted for one in differences.missing if not is_noise(one.effect)]
    added += [one.recording.fitted for one in differences.other_parameters]
    removed = [one.effect for one in differences.surplus if one.fitted is not None]
    removed += [one.simulation.effect for one in differences.other_parameters]
    return Mend(
        tuple(_at_run(fitted, recording, simulation) for fitted in added if fitted is not None),
        tuple(removed),
        tuple(_missing_noise(one) for one in differences.noise),
        recording.calibration,
        float(1 / np.median(np.diff(recording.recording.time_s))),
    )


def _at_run(fitted: FittedEffect, of: Side, at: Side) -> FittedEffect:
    """Return an effect whose times, now since the first sample, lie in the run of a side as they do in its own."""
    (first, last), (start, stop) = of.recording.time_span_s, at.recording.time_span_s
    stretch = (stop - start) / (last - first)
    begins = {name: first for name in _TIMES} | {"span_s": 0.0}
    moved = {name: stretch * (value - begins[name]) for name, value in fitted.shape.items() if name in begins}
    return replace(fitted, shape={**fitted.shape, **moved})


def _missing_noise(one: NoiseDifference) -> NoiseTerm:
    """Return the noise that an axis shall have, and what of it the simulation has not."""
    own, theirs = one.recording, one.simulation
    if not one.differs:
        return NoiseTerm(own.sensor, own.axis, theirs.white_T, 0.0)
    return replace(NoiseTerm.of(own), added_white_T=float(np.sqrt(max(own.white_T**2 - theirs.white_T**2, 0.0))))


def mended_twin(differences: Differences, simulation: Side, mend: Mend, seed: int) -> Recording:
    """Return the simulation's run as its sensors would read it with the mend.

    The field is that on which the sensors of the run agree; effects and noise of the simulation stay where the
    recording has them too.

    Parameters
    ----------
    differences : Differences
        Between simulation and recording.
    simulation : Side
        Whose run it is.
    mend : Mend
        Of the same differences.
    seed : int
        Of the noise.
    """
    left_out = [one.fitted for one in differences.surplus]
    left_out += [one.simulation.fitted for one in differences.other_parameters]
    kept = tuple(
        _at_run(cause.fitted, simulation, simulation)
        for cause in simulation.gap.causes
        if not (is_noise(cause.fitted.effect) or any(cause.fitted is fitted for fitted in left_out))
    )
    noise = [NoiseTerm.of(one.recording if one.differs else one.simulation) for one in differences.noise]
    # The readings of the scalar keep their own noise.
    noise = [*(one for one in noise if one.sensor), *(one for one in mend.noise if not one.sensor)]
    complete = replace(mend, added=(*kept, *mend.added), removed=(), noise=tuple(noise))
    return mended(_quiet(simulation), complete, seed, errors=simulation.calibration.errors)


def _quiet(side: Side) -> Recording:
    """Return the run of a side without effects, its sensors without noise; the scalar gives the intensity."""
    calibration = side.calibration
    model = side.found.model
    recording = calibration.without_effects(side.recording) if model.world is None else model.quiet()
    field = field_of(calibration.errors, calibration.array, recording, model)
    if recording.scalar_T is not None:
        known = np.isfinite(recording.scalar_T)
        field[known] *= (recording.scalar_T[known] / norm(field[known], axis=1))[:, None]
    return replace(recording, readings_T=calibration.errors.distort(field), interpolated_noise=None)


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
    # Eight times as far as the farthest sensor: 2 m for a cross of 0.5 m.
    distance = 8.0 * float(norm(array.positions_m, axis=1).max())
    error = float(np.sqrt(np.mean(side.calibration.output_standard_errors[3:] ** 2)))
    # The largest component of the gradient of a dipole is 6 x 10⁻⁷ m / r⁴.
    moment = 300.0 * error * distance**4 / 6e-7
    # As of an object on the ground ahead, found to about a tenth of a per cent by its gradient.
    return Dipole(distance * np.array([0.6, 0.48, -0.64]), moment * np.array([0.0, 0.6, 0.8]))


def source_error(recording: Recording, side: Side, source: Dipole) -> SourceError | None:
    """Return how far from a source near the array its samples place it in a recording; None where they cannot.

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
    # Enough for a median within a tenth of its size.
    chosen = recording.take(known[np.linspace(0, len(known) - 1, min(400, len(known))).astype(int)])
    assert chosen.attitude is not None
    regional = Regional(regional_of(calibration.correct(chosen).outputs, chosen.attitude).field_T)
    turns = Rotation.from_quat(chosen.attitude).as_matrix()
    world = source.field_T(np.einsum("nij,kj->nki", turns, calibration.array.positions_m))
    in_array = np.einsum("nji,nkj->nki", turns, world)
    added = np.einsum("kij,nkj->nki", calibration.errors.matrix, in_array)
    outputs = calibration.correct(replace(chosen, readings_T=chosen.readings_T + added)).outputs
    samples = Samples(outputs, calibration.array, calibration.output_covariance, chosen.attitude)
    in_array_m = locate_each(samples, regional)
    distance = norm(turned(in_array_m, chosen.attitude).position_m - source.position_m, axis=1)
    return _error(distance) if np.isfinite(distance).mean() > 0.5 else None


def _error(distance_m: FloatArray) -> SourceError:
    """Return the median of distances (N,) but NaN, with the interval that the medians of blocks of time give."""
    generator = np.random.default_rng(0)
    located_m = distance_m[np.isfinite(distance_m)]
    # The medians of 20 blocks of time show how certain the median of all is (bootstrap).
    blocks = [np.median(block) for block in np.array_split(located_m, min(20, len(located_m)))]
    drawn = np.median(generator.choice(blocks, (1000, 20)), axis=1)
    low, high = np.quantile(drawn, (0.025, 0.975))
    return SourceError(float(np.median(located_m)), (float(low), float(high)))
