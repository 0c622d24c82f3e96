"""The comparison of a simulator's recording with a real one: where, which, how far, and the mend.

The simulation's run is made again with the mend in it and judged once more. What the mission needs measures how much
this helps: how far from an added source ``tam locate`` would find it.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.comparison.additions import mended
from tam_calibration.comparison.agreement import is_noise
from tam_calibration.comparison.differences import Differences, differences_between
from tam_calibration.comparison.mend import Mend, NoiseTerm
from tam_calibration.comparison.mistakes import mistakes_of
from tam_calibration.comparison.result import Closing, Comparison, NoiseDifference, SourceError, Step
from tam_calibration.comparison.side import Figure, Side, side_by_side
from tam_calibration.effects.states import WINDOW_UNITS
from tam_calibration.gap.calibration_with_effects import calibration_of
from tam_calibration.gap.diagnose import in_stretches, judge
from tam_calibration.gap.noise import field_of
from tam_calibration.gap.search import Progress
from tam_calibration.integrity import ACCEPTABLE
from tam_calibration.localization.turned_samples import Regional, Samples, locate_each, regional_of, turned
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.fitted_effect import FittedEffect
from tam_calibration.model.recording import Recording, SampleSource
from tam_calibration.model.sensor_errors import PARAMETER_NAMES
from tam_calibration.model.units import FloatArray, to_nanotesla
from tam_calibration.sources.dipole import Dipole


def compare(
    simulation: SampleSource,
    recording: SampleSource,
    array: Array,
    *,
    array_of_simulation: Array | None = None,
    progress: Progress | None = None,
    seed: int = 0,
) -> Comparison:
    """Say what a simulator's recording has otherwise than a real one, and what to write into the simulator.

    The same judge looks at both: calibration, diagnosis and noise of each run by itself, as two runs never take the
    same path. Errors of the sensors, which a calibration removes, are stated and count as no difference.

    Parameters
    ----------
    simulation, recording : Recording or SampleSource
        Raw readings (N, K, 3), tesla, of the same number of sensors; runs, lengths, rates and sites may differ.
    array : Array
        Of the recording.
    array_of_simulation : Array, optional
        Of the simulation, where it is another.
    progress : callable, optional
        Called with the name of the stage and the part that is done, 0 to 1.
    seed : int
        Of the noise of the mended twin.

    Returns
    -------
    Comparison
        The verdict with its evidence.

    Raises
    ------
    InputError
        When one of the two cannot be used, or their numbers of sensors differ; it names which.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from tam_calibration import compare, read_scenario, simulate
    >>> scenario = read_scenario("wu_table_1")
    >>> one, other = (simulate(replace(scenario, seed=seed)) for seed in (1, 2))
    >>> compare(one.recording, other.recording, scenario.array).verdict
    'same'
    """
    array_of_simulation = array_of_simulation or array
    given = (("simulation", simulation, array_of_simulation), ("recording", recording, array))
    if simulation.sensor_count != recording.sensor_count:
        raise InputError(
            f"the simulation has {simulation.sensor_count} sensors, the recording {recording.sensor_count}: "
            "simulate the same array"
        )
    for name, source, own in given:
        if source.sensor_count != own.sensor_count:
            raise InputError(
                f"the {name} has {source.sensor_count} sensors, its array {own.sensor_count}: give the array file of it"
            )
    report = progress or (lambda what, part: None)
    report("mistakes", 0.0)
    seen = in_stretches(simulation)[0], in_stretches(recording)[0]
    with _named("recording"):  # in another unit every simulation would seem to have no field
        seen[1].check_units(array.field)
    if mistakes := mistakes_of(*seen, array_of_simulation, array):
        return Comparison("differs", f"The simulation cannot be right: {mistakes[0].what}.", mistakes)
    try:
        sides = _side(*given[0], _part(report, 0)), _side(*given[1], _part(report, 1))
    except Refused as problem:
        return Comparison("not_identifiable", f"No comparison: {str(problem).rstrip('.')}.")
    differences = differences_between(*sides)
    mend = mend_of(differences, *sides)
    closing = _closing(differences, mend, *sides, _part(report, 2), seed)
    figures = side_by_side(*sides)
    remarks = [f"The {one[0]}: {remark}" for one, side in zip(given, sides, strict=True) for remark in side.gap.remarks]
    return Comparison(
        "same" if differences.are_none else "differs",
        _statement(differences, closing, figures),
        (),
        figures,
        differences.missing,
        differences.surplus,
        differences.other_parameters,
        differences.noise,
        closing,
        mend,
        *sides,
        (*remarks, *differences.remarks),
    )


def side_of(source: SampleSource, array: Array, progress: Progress | None = None) -> Side:
    """Return what the judge says of a recording.

    Parameters
    ----------
    source : SampleSource
        Raw readings (N, K, 3), tesla.
    array : Array
        Geometry and noise.
    progress : callable, optional
        Called with the name of the stage and the part that is done, 0 to 1.

    Raises
    ------
    InputError
        When the recording cannot be used.
    Refused
        When it determines no calibration.
    """
    judgement = judge(source, array, progress=progress)
    gap, found, recording = judgement.gap, judgement.found, judgement.seen
    if found is None or gap.verdict == "not_identifiable":
        raise Refused(gap.statement)
    calibration = calibration_of(recording, found, gap, array, accept=ACCEPTABLE)
    return Side(recording, array, gap, calibration, found)


def _part(report: Progress, number: int) -> Progress:
    """Return a callback for one of the three parts of the work."""
    return lambda stage, done: report(stage, (number + done) / 3)


def _side(name: str, source: SampleSource, array: Array, progress: Progress) -> Side:
    with _named(name):
        return side_of(source, array, progress)


@contextmanager
def _named(name: str) -> Iterator[None]:
    """Name the side of the two that is refused."""
    try:
        yield
    except (InputError, Refused) as problem:
        raise type(problem)(f"the {name}: {problem}") from problem


def _closing(
    differences: Differences, mend: Mend, simulation: Side, recording: Side, progress: Progress, seed: int
) -> Closing:
    """Return how far the gap shrinks: the mended twin is judged again."""
    before, left, mended = differences.energy, differences, simulation
    if not differences.are_none:
        try:
            twin = mended_twin(differences, simulation, mend, seed)
            mended = side_of(twin, simulation.array, progress)
        except (InputError, Refused) as problem:
            untried = f"the mend cannot be tried in the simulation's run: {problem}"
            return replace(_sizes_of(before, float("nan"), (0.0, 1.0), recording), left=untried)
        left = differences_between(mended, recording).that_show
    interval = _interval(before, left.energy, left.undecided_energy, recording.gap.channel_count)
    source = source_of(recording)
    of_simulation, of_recording, of_mended = (
        None if source is None else source_error(one.recording, one, source) for one in (simulation, recording, mended)
    )
    return replace(
        _sizes_of(before, left.energy, interval, recording),
        steps=_steps(differences, left.energy),
        simulation_source=of_simulation,
        recording_source=of_recording,
        mended_source=of_mended,
        left="; ".join([*(words for words, _ in left.energies), *(remark.rstrip(".") for remark in left.remarks)]),
    )


def _sizes_of(before: float, after: float, interval: tuple[float, float], side: Side) -> Closing:
    """Return the sizes of the gap for energies before and after, in squares of a side's noise floor."""
    array, floor_T = side.calibration.array, side.gap.size.floor_T
    gradient = float(norm(side.calibration.output_standard_errors[3:])) if array.has_gradient else np.nan
    closed = max(1 - after / before, 0.0) if before > 0 else 0.0 * after
    first, last = float(np.sqrt(before)), float(np.sqrt(after))
    in_units = first * floor_T, last * floor_T, first * gradient, last * gradient
    return Closing(first, last, *in_units, floor_T, closed, interval)


def _interval(before: float, after: float, undecided: float, count: float) -> tuple[float, float]:
    """Return the 95 % interval of the part that closes, by error propagation.

    An energy g² of n channels has the variance (2 + 4 g²) / n, that of a noncentral chi-square over n. The lower end
    takes what is undecided for left.
    """
    if before <= 0:
        return (0.0, 1.0)
    variance = (2 + 4 * after) / count / before**2 + (2 + 4 * before) / count * after**2 / before**4
    closed, half = 1 - after / before, 1.96 * float(np.sqrt(variance))
    return (float(np.clip(closed - undecided / before - half, 0, 1)), float(np.clip(closed + half, 0, 1)))


def _steps(differences: Differences, after: float) -> tuple[Step, ...]:
    """Return the gap after each term; the last is that of the twin which was judged again."""
    left = differences.energy - np.cumsum([energy for _, energy in differences.energies])
    sizes = np.sqrt(np.maximum(left, after)).tolist()
    return tuple(Step(words, size) for (words, _), size in zip(differences.energies, sizes, strict=True))


def _statement(differences: Differences, closing: Closing, figures: Sequence[Figure]) -> str:
    if differences.are_none:
        return _same(figures)
    words, _ = differences.energies[0] if differences.energies else ("other noise", 0.0)
    begin = f"They differ by {closing.before:.2g} noise floors, most by {words}; "
    if not np.isfinite(closing.after):
        return f"{begin}the mend cannot be tried."
    most = closing.before * float(np.sqrt(1 - closing.closed_interval[0]))
    return f"{begin}mended, by {closing.after:.2g}, at most {most:.2g}."


def _same(figures: Sequence[Figure]) -> str:
    """Return that nothing differs, and by how much at most the errors of the sensors do."""
    errors = [one for one in figures if one.recording.name in PARAMETER_NAMES]
    if all(one.standing != "differs" for one in errors):
        return "The same: calibration, effects and noise of the simulation are those of the recording."
    bias, scale = (
        max((one for one in errors if one.recording.name in PARAMETER_NAMES[own]), key=lambda one: one.difference)
        for own in (slice(6, 9), slice(0, 3))
    )
    return (
        "The same: effects and noise of the simulation are those of the recording. The errors of their sensors differ, "
        f"biases by up to {to_nanotesla(bias.difference):.3g} nT ({bias.recording.group} {bias.recording.name[-1]}), "
        f"scale factors by up to {100 * scale.difference:.2g} %: a calibration removes them."
    )


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
