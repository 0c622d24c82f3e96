"""Whether an answer of `tam locate` is one: what is no dipole is refused, what is one is answered with honest errors.

Run ``python benchmarks/localization_fit.py [--runs 100] [--seed 1] [--judged]``. An array of 0.5 m with errors of Wu's
size is calibrated from 400 samples of 1 nT; then it passes dipoles at 1 m/s with 1 to 0.05 nT of noise, or hears coils
and cables of 10 Hz. Every run draws another array, calibration, place and moment. A wrong answer is more than five
standard errors from every source. The kinds of ``--judged`` were written before any was answered; the rules were tuned
on the others alone.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import click
import numpy as np
from asked import ANYTHING, Figure, show
from live import ARRAY, errors_of
from localization_grid import Line
from numpy.linalg import norm
from scipy.spatial.transform import Rotation

from tam_calibration.correction.calibration import Calibration
from tam_calibration.files.text_files import write_whole
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.localization.alternating import locate_alternating
from tam_calibration.localization.solutions import Survey
from tam_calibration.localization.targets import find_targets, path_in
from tam_calibration.model.array import UNIT_TENSORS
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla
from tam_calibration.sources.dipole import Dipole, Loop

Answer = tuple[FloatArray, FloatArray, FloatArray]
"""Places (n, 3) of what was found, their covariances (n, 3, 3), and the true places (S, 3), metres."""

RESULTS = Path(__file__).parent / "results" / "localization_fit.csv"
EARTH_T = np.array([1e-6, 20e-6, -45e-6])
"""East, north, up, of middle latitudes."""

_NINETY_FIVE, _FAR_OFF = 1.96, 5.0
"""Standard errors of a 95 % interval, and from which an answer is wrong: by chance one in two million."""


def calibrated(errors: SensorErrors, generator: np.random.Generator) -> Calibration:
    """Return the calibration of the array from 400 samples of 1 nT."""
    direction = generator.normal(size=(400, 3))
    field = 50e-6 * direction / norm(direction, axis=1, keepdims=True)
    readings = errors.distort(field) + 1e-9 * generator.normal(size=(400, 4, 3))
    scalar_T = 50e-6 + 1e-10 * generator.normal(size=400)
    return maximum_likelihood(Recording(np.arange(400.0), readings, scalar_T), ARRAY)


@dataclass(frozen=True)
class Pass:
    """A pass: noise [nT], sensor 1 askew [deg], sources, gradient [nT/m], attitude [deg], samples."""

    noise_nT: float = 0.1
    askew_deg: float = 0.0
    sources: int = 1
    gradient_nT_per_m: float = 1.0
    attitude_deg: float = 0.0
    samples: int = 150

    def __call__(self, generator: np.random.Generator) -> Answer:
        """Return the answer to one pass, and the true places (S, 3) of its sources."""
        errors = errors_of(generator)
        askew = from_degrees(self.askew_deg) * _unit(generator)
        errors = SensorErrors.from_matrix(errors.matrix @ Rotation.from_rotvec(askew).as_matrix(), errors.bias_T)
        calibration = calibrated(errors, generator)
        time = np.arange(self.samples) * (60 / self.samples)
        path = np.outer(time, np.array([1.0, 0, 0]) + 0.01 * generator.normal(size=3))
        sway = Rotation.from_euler("zyx", 0.1 * np.sin(np.outer(time, [0.2, 0.33, 0.5]) + generator.uniform(0, 6, 3)))
        points = path[:, None] + np.einsum("nij,kj->nki", sway.as_matrix(), ARRAY.positions_m)
        tensor = np.tensordot(generator.normal(size=5), UNIT_TENSORS, 1)
        tensor *= from_nanotesla(self.gradient_nT_per_m) / np.abs(np.linalg.eigvalsh(tensor)).max()
        sources = [_passed(generator) for _ in range(self.sources)]
        world = EARTH_T + points @ tensor + sum(each.field_T(points) for each in sources)
        fields = np.einsum("nji,nkj->nki", sway.as_matrix(), world)
        noise = from_nanotesla(self.noise_nT) * generator.normal(size=fields.shape)
        angle = from_degrees(self.attitude_deg)
        reported = sway * Rotation.from_rotvec(angle * generator.normal(size=(self.samples, 3)))
        recording = Recording(time, errors.distort(fields) + noise, attitude=reported.as_quat())
        line = find_targets(recording, calibration, path_in(recording, np.array([1.0, 0, 0])), angle)
        dipoles = [each for each in line.targets if not each.is_extended]
        if not dipoles:
            raise Refused("extended alone" if line.targets else "no target")
        return (
            np.array([each.position_m for each in dipoles]),
            np.array([each.position_covariance_m2 for each in dipoles]),
            np.array([each.position_m for each in sources]).reshape(-1, 3),
        )


def _passed(generator: np.random.Generator) -> Dipole:
    angle, distance = generator.uniform(-1, 1), generator.uniform(2.5, 5)
    place = np.array([30 + generator.uniform(-6, 6), distance * np.sin(angle), -distance * np.cos(angle)])
    return Dipole(place, 10 ** generator.uniform(1.5, 2.7) * _unit(generator))


@dataclass(frozen=True)
class Heard:
    """Sources of 10 Hz that are heard for eight seconds.

    Kind and number of the sources, the index they are taken for, how the array turns (``still``, ``headings`` or
    ``turning``), their phase against the first [rad], error of the stated frequency [Hz], noise [nT], places of the
    sensors [mm].
    """

    kind: str = "coil"
    count: int = 1
    index: float = 3.0
    turns: str = "headings"
    phase: float = 0.0
    off_hz: float = 0.0
    noise_nT: float = 1.0
    places_mm: float = 0.0

    def __call__(self, generator: np.random.Generator) -> Answer:
        """Return the answer to one recording, and the places (S, 3) of its sources."""
        errors = errors_of(generator)
        calibration = calibrated(errors, generator)
        time = np.arange(800) / 100
        turns = self._turns(time, generator)
        positions = ARRAY.positions_m + 1e-3 * self.places_mm * generator.normal(size=(4, 3))
        points = np.einsum("nij,kj->nki", turns.as_matrix(), positions)
        world = np.broadcast_to(EARTH_T, points.shape).copy()
        sources = [_heard(self.kind, generator) for _ in range(self.count)]
        phases = generator.uniform(0, 6) + self.phase * np.arange(self.count)
        for source, phase in zip(sources, phases, strict=True):
            world += np.sin(2 * np.pi * 10 * time + phase)[:, None, None] * source.field_T(points)
        fields = np.einsum("nji,nkj->nki", turns.as_matrix(), world)
        noise = from_nanotesla(self.noise_nT) * generator.normal(size=fields.shape)
        attitude = None if self.turns == "still" else turns.as_quat()
        recording = Recording(time, errors.distort(fields) + noise, attitude=attitude)
        survey = locate_alternating(recording, calibration, 10.0 + self.off_hz, index=self.index)
        center = np.zeros(3)
        places = np.array([s.nearest_m(center) if isinstance(s, Line) else s.position_m for s in sources])
        return *_found(survey), places

    def _turns(self, time_s: FloatArray, generator: np.random.Generator) -> Rotation:
        if self.turns == "turning":
            return Rotation.from_euler(
                "zyx", 0.4 * np.sin(np.outer(time_s, [1.1, 1.7, 2.3]) + generator.uniform(0, 6, 3))
            )
        headings = np.arange(4) * np.pi / 2 if self.turns == "headings" else np.zeros(4)
        return Rotation.from_euler("z", np.repeat(headings, len(time_s) // 4)[:, None])


def _heard(kind: str, generator: np.random.Generator) -> Dipole | Loop | Line:
    place, along = generator.uniform(2, 4) * _unit(generator), _unit(generator)
    moment = 10 ** generator.uniform(1, 2.7) * _unit(generator)
    if kind == "large coil":
        return Loop(place, moment, float(norm(place)) / 5)
    if kind == "cable":
        return Line(place - (place @ along) * along, along, 10 ** generator.uniform(0, 1), np.zeros(3))
    if kind == "line of dipoles":
        return Line(place - (place @ along) * along, along, 0.0, moment - (moment @ along) * along)
    return Dipole(place, moment)


def _unit(generator: np.random.Generator) -> FloatArray:
    drawn = generator.normal(size=3)
    return np.asarray(drawn / norm(drawn))


def _found(survey: Survey) -> tuple[FloatArray, FloatArray]:
    if survey.overall is not None:
        return survey.overall.position_m[None], survey.overall.position_covariance_m2[None]
    at = survey.solutions.is_located
    return survey.solutions.position_m[at], survey.solutions.position_covariance_m2[at]


Run = Callable[[np.random.Generator], Answer]
"""From a generator to an answer and the true places of the sources; raises ``Refused``."""

TUNED: dict[str, tuple[Run, bool]] = {
    "a dipole passed, 1 nT": (Pass(1.0), True),
    "a dipole passed, 0.2 nT": (Pass(0.2), True),
    "a dipole passed, 0.05 nT": (Pass(0.05), True),
    "a dipole passed, 0.1 nT, attitude to 0.05°": (Pass(attitude_deg=0.05), True),
    "a dipole passed, 0.1 nT, sensor 1 askew by 0.6°": (Pass(askew_deg=0.6), False),
    "nothing passed, 0.1 nT": (Pass(sources=0), False),
    "nothing passed, 0.1 nT, sensor 1 askew by 0.6°": (Pass(askew_deg=0.6, sources=0), False),
    "two dipoles passed, 0.1 nT": (Pass(sources=2), True),
    "a coil, one pose": (Heard(turns="still"), True),
    "a coil, four headings": (Heard(), True),
    "a coil, turning": (Heard(turns="turning"), True),
    "a coil, places to 1 mm, four headings": (Heard(places_mm=1.0), True),
    "two coils, unlike phases, one pose": (Heard(count=2, phase=0.7, turns="still"), False),
    "two coils, unlike phases, turning": (Heard(count=2, phase=0.7, turns="turning"), False),
    "two coils in phase, four headings": (Heard(count=2), False),
    "a cable taken for a dipole, one pose": (Heard("cable", turns="still"), False),
    "a coil, frequency off by 0.02 Hz, turning": (Heard(off_hz=0.02, turns="turning"), False),
}
"""By name, how a run is made and whether it should be answered."""

JUDGED: dict[str, tuple[Run, bool]] = {
    "a dipole passed, 0.1 nT": (Pass(samples=240), True),
    "a dipole passed, 0.07 nT, no gradient": (Pass(0.07, gradient_nT_per_m=0.0), True),
    "nothing passed, 1 nT": (Pass(1.0, sources=0), False),
    "a gradient of 10 nT/m passed, 0.1 nT": (Pass(sources=0, gradient_nT_per_m=10.0), False),
    "two dipoles passed, 1 nT": (Pass(1.0, sources=2), True),
    "a dipole passed, 0.05 nT, sensor 1 askew by 1°": (Pass(0.05, askew_deg=1.0), False),
    "a coil, 0.1 nT, four headings": (Heard(noise_nT=0.1), True),
    "a coil, 0.1 nT, turning": (Heard(noise_nT=0.1, turns="turning"), True),
    "a coil, places to 0.5 mm, one pose": (Heard(places_mm=0.5, turns="still"), True),
    "a cable, places to 1 mm, four headings": (Heard("cable", index=1.0, places_mm=1.0), True),
    "a cable, four headings": (Heard("cable", index=1.0), True),
    "two coils in phase, one pose": (Heard(count=2, turns="still"), False),
    "two coils in phase, turning": (Heard(count=2, turns="turning"), False),
    "two coils, unlike phases, four headings": (Heard(count=2, phase=0.2), False),
    "a cable taken for a dipole, four headings": (Heard("cable"), False),
    "a coil taken for a cable, one pose": (Heard(index=1.0, turns="still"), False),
    "a line of dipoles taken for a dipole, one pose": (Heard("line of dipoles", turns="still"), False),
    "a coil as large as a fifth of its distance, one pose": (Heard("large coil", turns="still"), False),
    "a coil, frequency off by 0.03 Hz, one pose": (Heard(off_hz=0.03, turns="still"), False),
}


def outcome(name: str, seed: int, run: int) -> tuple[str, FloatArray]:
    """Return why a run was refused, or nothing and the pulls (n, 3) of its answer."""
    kinds = TUNED | JUDGED
    try:
        found, spread, places = kinds[name][0](np.random.default_rng((seed, list(kinds).index(name), run)))
    except Refused as refusal:
        return str(refusal), np.zeros((0, 3))
    errors = np.sqrt(np.diagonal(spread, axis1=1, axis2=2))
    if not len(places):
        return "", np.full_like(found, np.inf)
    pulls = (found[:, None] - places) / errors[:, None]
    nearest = np.abs(pulls).max(axis=2).argmin(axis=1)
    return "", pulls[np.arange(len(found)), nearest]


def figures(name: str, is_sound: bool, results: Sequence[tuple[str, FloatArray]]) -> list[Figure]:
    """Return how many runs are answered, how many wrongly, and the coverage of the answers."""
    answered = [pulls for reason, pulls in results if not reason]
    wrong = sum(bool((np.abs(pulls) > _FAR_OFF).any()) for pulls in answered)
    kind = "sound" if is_sound else "no dipole"
    share = len(answered) / len(results)
    made = [
        Figure(name, kind, "answered", share, asked=(0.95, 1.0) if is_sound else ANYTHING),
        Figure(name, kind, "wrong answers", wrong / len(results), asked=(0.0, 0.01)),
    ]
    if answered and is_sound:
        inside = np.array([np.mean(np.abs(pulls) < _NINETY_FIVE) for pulls in answered])
        spread = float(inside.std() / np.sqrt(len(inside)))
        made.append(Figure(name, kind, "95 % intervals that cover", float(inside.mean()), spread, (0.93, 0.97)))
    return made


@click.command(help=__doc__)
@click.option("--runs", default=100, show_default=True, help="Of each kind.")
@click.option("--seed", default=1, show_default=True, help="Of all random numbers.")
@click.option("--judged", is_flag=True, help="The kinds that nothing was tuned on.")
@click.option("--only", default="", help="Kinds that have these words in their name.")
@click.option("--processes", default=1, show_default=True, help="That work side by side.")
def main(runs: int, seed: int, judged: bool, only: str, processes: int) -> None:
    """Run the benchmark."""
    done: list[Figure] = []
    with ProcessPoolExecutor(processes) as pool:
        for name, (_, is_sound) in (JUDGED if judged else TUNED).items():
            if only not in name:
                continue
            results = list(pool.map(partial(outcome, name, seed), range(runs)))
            made = figures(name, is_sound, results)
            click.echo("\n".join(figure.line for figure in made))
            done += made
            reasons = [reason for reason, _ in results if reason]
            for reason, times in Counter(each.split(":")[0] for each in reasons).most_common():
                click.echo(f"{name}: {times} refused: {reason}")
    show(done, f"Tests of fit, {runs} runs of each kind", "kind")
    if not only:
        command = f"# python benchmarks/localization_fit.py --runs {runs} --seed {seed}{' --judged' * judged}"
        with write_whole(RESULTS.with_stem(f"{RESULTS.stem}{'_judged' * judged}")) as path:
            head = "case,method,figure,value,standard_error,asked,met"
            path.write_text("\n".join([command, head, *(figure.line for figure in done)]) + "\n")


if __name__ == "__main__":
    main()
