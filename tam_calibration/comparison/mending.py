"""The mend of a simulation, and the twin of its run with the mend in it."""

from dataclasses import replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.comparison.additions import mended
from tam_calibration.comparison.differences import Differences, is_noise
from tam_calibration.comparison.result import AxisNoise, Mend, NoiseDifference, NoiseTerm, Side
from tam_calibration.comparison.side import field_of, without_effects
from tam_calibration.effects.switching import WINDOW_UNITS
from tam_calibration.model.fitted_effect import FittedEffect
from tam_calibration.model.recording import Recording

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
        _rate_hz(recording),
    )


def _rate_hz(side: Side) -> float:
    return float(1 / np.median(np.diff(side.recording.time_s)))


def _at_run(fitted: FittedEffect, of: Side, at: Side) -> FittedEffect:
    """Return an effect whose times, now since the first sample, lie in the run of a side as they do in its own."""
    (first, last), (start, stop) = of.recording.time_span_s, at.recording.time_span_s
    stretch = (stop - start) / (last - first)
    shape = dict(fitted.shape)
    for name, value in fitted.shape.items():
        if name in _TIMES:
            shape[name] = stretch * (value - first)
        elif name == "span_s":
            shape[name] = stretch * value
    return replace(fitted, shape=shape)


def _missing_noise(one: NoiseDifference) -> NoiseTerm:
    """Return the noise that an axis shall have, and what of it the simulation has not."""
    own, theirs = one.recording, one.simulation
    if not one.differs:
        return NoiseTerm(own.sensor, own.axis, theirs.white_T, 0.0)
    added_T = float(np.sqrt(max(own.white_T**2 - theirs.white_T**2, 0.0)))
    return replace(_term(own), added_white_T=added_T)


def _term(noise: AxisNoise) -> NoiseTerm:
    """Return all the noise of an axis as noise to add."""
    return NoiseTerm(
        noise.sensor,
        noise.axis,
        noise.white_T,
        noise.white_T,
        noise.knee_hz,
        noise.exponent,
        noise.band_hz,
        noise.band_T,
    )


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
    noise = [
        _term(one.recording if one.differs else one.simulation) for one in differences.noise if one.recording.sensor
    ]
    of_scalar = [term for term in mend.noise if not term.sensor]  # whose own noise stays in its readings
    whole = replace(mend, added=(*kept, *mend.added), removed=(), noise=(*noise, *of_scalar))
    return mended(_quiet(simulation), whole, seed, errors=simulation.calibration.errors)


def _quiet(side: Side) -> Recording:
    """Return the run of a side without effects, its sensors without noise; the scalar tells the intensity."""
    calibration = side.calibration
    recording = without_effects(calibration, side.recording, side.found.model)
    field = field_of(calibration, recording, side.found.model)
    if recording.scalar_T is not None:
        known = np.isfinite(recording.scalar_T)
        field[known] *= (recording.scalar_T[known] / norm(field[known], axis=1))[:, None]
    return replace(recording, readings_T=calibration.errors.distort(field))
