"""From a recording to the source in it, at rest or alternating.

The samples of a run are located each by itself, and judged whether they are those of one source at rest in a uniform
field. A line of dipoles leaves nothing of the two components of the regional field across it: field and tensor there
are as many numbers as its place and moment.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from tam_calibration.core.least_squares import MOST_STEPS
from tam_calibration.core.noise import COSINES
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.maximum_a_posteriori import SETTLED
from tam_calibration.fit.recorded_attitude import misread_attitude
from tam_calibration.localization.alternating import locate_alternating
from tam_calibration.localization.euler import CURRENT_INDEX, DIPOLE_INDEX, DIPOLES_INDEX
from tam_calibration.localization.shared_source import SharedSource, fit_regional, fit_shared
from tam_calibration.localization.solutions import WORLD_FRAME, EulerSolutions, Status, Survey
from tam_calibration.localization.source_fit import SOURCES, require_gradient, require_index
from tam_calibration.localization.turned_samples import Regional, Samples, locate_each, regional_of, turned
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.geomagnetic_field import LOCAL_VARIANCE_T2
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.demodulation import CHANCE


def locate(
    recording: Recording, calibration: Calibration, *, index: float = DIPOLE_INDEX, frequency_hz: float | None = None
) -> Survey:
    """Locate the source in a recording.

    ``locate_steady`` and ``alternating.locate_alternating`` take more: a known regional field, a platform that
    goes straight, a frequency that is to be found.

    Parameters
    ----------
    recording : Recording
        Raw readings (N, K, 3), tesla, with the attitude (x, y, z, w, from the array frame to the world) where the
        source is at rest.
    calibration : Calibration
        Of its array.
    index : float
        Structural index of Euler's equation: 3 of a dipole, 2 of a line of dipoles, 1 of a line of current.
    frequency_hz : float, optional
        Of an alternating source, hertz; without it the source is at rest.

    Returns
    -------
    Survey
        Position in metres and moment in A m² of each sample or pose, with covariances, counted from the array; axes of
        the world, or of the array where there is no attitude.

    Raises
    ------
    InputError
        When the calibration is of another array, or the recording lacks what is needed.
    Refused
        When nothing can be located.

    Examples
    --------
    A dipole 3.7 m away that alternates at 10 Hz, beside the Earth's field:

    >>> import numpy as np
    >>> from tam_calibration import Recording, calibrate, locate, read_scenario, simulate
    >>> from tam_calibration.sources.dipole import Dipole
    >>> made = simulate(read_scenario("wu_table_1"))
    >>> calibration = calibrate(made.recording, made.scenario.array)
    >>> source = Dipole(np.array([3.0, 1.0, -2.0]), np.array([20.0, 0.0, 500.0]))
    >>> time_s = np.arange(1000) / 100
    >>> swing = np.cos(2 * np.pi * 10 * time_s)[:, None, None]
    >>> field_T = np.array([0.0, 20e-6, -45e-6]) + swing * source.field_T(made.scenario.array.positions_m)
    >>> survey = locate(Recording(time_s, calibration.errors.distort(field_T)), calibration, frequency_hz=10.0)
    >>> survey.solutions.position_m.round(1) + 0.0
    array([[ 3.,  1., -2.]])
    """
    if frequency_hz is None:
        return locate_steady(recording, calibration, index=index)
    return locate_alternating(recording, calibration, frequency_hz, index=index)


def locate_steady(
    recording: Recording,
    calibration: Calibration,
    *,
    index: float = DIPOLE_INDEX,
    regional_T: FloatArray | None = None,
    regional_covariance_T2: FloatArray = LOCAL_VARIANCE_T2,
    attitude_noise: float = 0.0,
) -> Survey:
    """Locate a source at rest in each sample: its position counts from the array.

    Parameters
    ----------
    recording : Recording
        With attitude.
    calibration : Calibration
        Of its array.
    index : float
        Structural index: 3 of a dipole, 2 of a line of dipoles, 1 of a line of current.
    regional_T : (3,) array, optional
        Field beside the source's in the world, tesla; fitted where it is not given.
    regional_covariance_T2 : (3, 3) array
        Of that, T²; by default as of a main field model.
    attitude_noise : float
        Standard deviation of the attitude about each axis, radians.

    Raises
    ------
    InputError
        When there is no attitude, or the calibration is of another array.
    Refused
        When the attitude was written otherwise than expected, no sample can be located, or the samples are not those
        of one source.
    """
    require_index(index)
    if misread := misread_attitude(recording, calibration.errors):
        raise Refused(misread)
    if recording.attitude is None:
        raise InputError(
            "the recording has no attitude, without which the regional field cannot be taken off; of an alternating "
            "source give the frequency"
        )
    require_gradient(calibration.array)
    if index != DIPOLE_INDEX and attitude_noise:
        raise Refused(
            f"a {SOURCES[index]} is located with an exact attitude alone: the regional field, turned by an "
            "error of it, hides what tells one line from several"
        )
    if index == DIPOLES_INDEX and regional_T is None:
        raise Refused(
            f"beside a {SOURCES[index]} the regional field cannot be found from the samples: give the "
            "place, at which it is that of IGRF"
        )
    outputs = calibration.correct(recording).outputs
    samples = Samples(outputs, calibration.array, calibration.output_covariance, recording.attitude, index)
    if regional_T is None:
        prior = regional_of(outputs, recording.attitude, attitude_noise)
    else:
        prior = Regional(regional_T, attitude_noise, regional_covariance_T2)
    world, found = locate_run(samples, prior)
    return Survey(WORLD_FRAME, recording.time_s, world, regional_T=found.field_T)


_FEWEST_LOCATED = 10
"""Samples of a run: of fewer, what is left does not tell a second source that moves them by ten standard errors."""

_MOST_SHARED = 200
"""Samples that tell what is shared: of thousands the errors of second order, alike in all places that are uncertain by
up to a fifth, would be more than noise."""

_MEND = (
    "Take a longer stretch about one source, or of dipoles give the velocity of a straight track, along which several "
    "of them and a gradient of the field are found"
)


def locate_run(samples: Samples, prior: Regional) -> tuple[EulerSolutions, Regional]:
    """Locate the source of each sample of a run beside the regional field that all of them need.

    The samples that are located beside the field as it is known tell it better, with which more are located, until it
    stays. What one source then leaves of all samples is tested.

    Parameters
    ----------
    samples : Samples
        With an attitude.
    prior : Regional
        What is known of the field beside the source.

    Returns
    -------
    solutions : EulerSolutions
        Along the axes of the world, counted from the array.
    regional : Regional
        The field beside them.

    Raises
    ------
    Refused
        When all samples together leave more than noise beside one source and a uniform regional field, or too few are
        located to tell.
    """
    assert samples.attitude is not None
    regional, part = prior, np.zeros(0, dtype=int)
    # A current's field falls so slowly that no part of a run is free of it: the median of the run is so far off that
    # samples are first located as if it were exact, and each has a line of its own.
    is_far = samples.index == CURRENT_INDEX and bool(prior.covariance_T2.any())
    if is_far:
        regional = replace(prior, covariance_T2=np.zeros((3, 3)))
    for number in range(MOST_STEPS):
        world = turned(locate_each(samples, regional), samples.attitude, prior.attitude_noise)
        at = np.flatnonzero(world.is_located)
        if not len(at) and not number:
            return world, regional
        if number and len(at) < _FEWEST_LOCATED:  # even with the field that the first ones determine
            break
        part = _part_of(at, part)
        if is_far and not number:
            regional = fit_regional(samples.take(part), world.take(part), regional, prior)
            continue
        shared = fit_shared(samples.take(part), world.take(part), regional, prior)
        is_settled, regional = _is_near(regional, shared.regional), shared.regional
        if is_settled and shared.solution.is_found[0]:
            break
    else:
        raise Refused(f"{_not_of_one(samples.index)}: no source explains all of them. {_MEND}")
    if len(at) < _FEWEST_LOCATED:
        raise Refused(
            f"only {len(at)} samples are located, too few to tell one source from several: {_FEWEST_LOCATED} are "
            f"needed. {_MEND}"
        )
    _require_noise(shared, samples.index)
    if len(part) < len(at):
        shared = fit_shared(samples.take(at), world.take(at), regional, prior)
    world.status[at[_is_apart(world.take(at), shared)]] = Status.APART
    return world.tested(samples.freedom), regional


def _part_of(at: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return the samples (n,) that tell what is shared: those of before, as long as half are located, or others."""
    if len(at) <= _MOST_SHARED:
        return at
    kept: np.ndarray = np.intersect1d(before, at)
    if len(kept) >= _MOST_SHARED // 2:
        return kept
    return np.asarray(at[np.linspace(0, len(at) - 1, _MOST_SHARED).round().astype(int)])


def _is_near(before: Regional, after: Regional) -> bool:
    """Return whether a regional field hardly moved, in units of its standard errors."""
    errors = np.sqrt(np.diag(after.covariance_T2))
    return bool((np.abs(after.field_T - before.field_T) <= SETTLED * errors).all())


def _require_noise(shared: SharedSource, index: float) -> None:
    """Refuse what one source leaves of a run if it is more than noise, in all or where it is slow."""
    from scipy.fft import dct
    from scipy.special import chdtrc

    energy = np.sum(dct(shared.residuals, axis=0, norm="ortho") ** 2, axis=1)
    waves = dct(shared.slopes, axis=0, norm="ortho")
    taken = np.einsum("ndp,pq,ndq->n", waves, shared.solution.covariance[0], waves, optimize=True)
    # Bands of cosines: the slowest, and then each as many times wider.
    edges = [0, *(COSINES**power for power in range(1, 20) if COSINES**power < len(energy))]
    for low, high in pairwise([*edges, len(energy)]):
        left, own = float(energy[low:high].sum()), float((shared.freedom - taken)[low:high].sum())
        if chdtrc(own, left) * len(edges) < CHANCE:
            raise Refused(
                f"{_not_of_one(index)}: what is left is {np.sqrt(left / own):.3g} times the noise, where it is "
                f"{'slow' if low == 0 else 'fast'}. {_MEND}"
            )


def _not_of_one(index: float) -> str:
    return f"the samples are not those of one {SOURCES[index]} at rest beside a uniform regional field"


def _is_apart(own: EulerSolutions, shared: SharedSource) -> np.ndarray:
    """Return which samples by themselves are elsewhere than all together have them: they have several solutions."""
    from scipy.special import chdtri

    off = (own.position_m - shared.position_m) @ shared.across
    spread = shared.across.T @ own.position_covariance_m2 @ shared.across
    size = np.einsum("ni,ni->n", off, np.linalg.solve(spread, off[..., None])[..., 0])
    return np.asarray(size > chdtri(off.shape[1], CHANCE))
