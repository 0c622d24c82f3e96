"""What the experiments of the four papers have beyond their models, and which law would make it.

Run ``python benchmarks/papers_gap.py [--seeds 40] [--diagnosed 10]``. It prints the tables of ``papers_gap.md``.

Each experiment is simulated as its paper describes it: printed errors, baseline, poses drawn within what is stated, the
noise of the paper's own simulation, the paper's own procedure. Then one law is added, in a new random form for each
seed. Its size, the root mean square on an axis of a sensor, is the one at which the printed figures are most likely.

The distance is the root mean square of the logarithms of printed over median, as a factor. The probability is that of
figures as far from the median as the printed ones, by Hotelling's T² of the logarithms over the seeds. Last, ``tam
diagnose`` runs on recordings with the law that makes the printed figures most likely.
"""

import csv
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np
from numpy.linalg import norm, slogdet, solve
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation
from scipy.stats import f

from tam_calibration import diagnose
from tam_calibration.files.text_files import write_whole
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray, from_nanotesla, to_nanotesla
from tam_calibration.results.results_json import gap_to_mapping
from tam_calibration.sources.dipole import dipole_field
from tam_validation.papers import chi2017, li2018a, li2018b
from tam_validation.papers.cross import SetUp, intensity_rms_T, tensor_rms_T_per_m
from tam_validation.papers.ellipsoids import orthogonal_fields
from tam_validation.papers.printed import printed_in
from tam_validation.papers.wu2025_experiment import mean_absolute_nT, simulate, turntable
from tam_validation.papers.wu2025_sweeps import published_errors

RESULTS = Path(__file__).parent / "results" / "papers_gap.csv"
HEADER = (
    "paper",
    "law",
    "size (nT)",
    "distance",
    "left of it",
    "probability",
    "within 90 %",
    "printed",
    "median",
    "90 % range",
)
DIAGNOSED = ("paper", "law", "recording", "answers")
SCALAR_NOISE_T = from_nanotesla(0.1)
"""Stated for ``tam diagnose``: that of a proton magnetometer."""
_SIZES_NT = (0.1, 3000.0)
"""Between which the size of a law is looked for."""
_ROUNDING = 0.002
"""Part of a printed figure that its digits are worth."""

Form = Callable[[SetUp, FloatArray, np.random.Generator], FloatArray]
"""Draws what a law adds to the readings (N, 4, 3) of a set-up in poses (N, 3, 3), up to a factor."""


def through(case: SetUp, field: FloatArray) -> FloatArray:
    """Return what the sensors read of a field (N, 4, 3) in the array's frame."""
    return np.asarray(np.einsum("kij,nkj->nki", case.errors.matrix, field))


def noise(case: SetUp, _: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Add noise to each axis of each sensor."""
    return rng.normal(size=case.recording.readings_T.shape)


def common_field(case: SetUp, _: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Let the field at the array change at random from pose to pose, the same at all sensors."""
    return through(case, np.repeat(rng.normal(size=(len(case.field_T), 1, 3)), 4, axis=1))


def site_gradient(case: SetUp, to_world: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Let the site have a gradient: the field is another at each place that a sensor turns through."""
    matrix = rng.normal(size=(3, 3))
    gradient = matrix + matrix.T
    gradient -= np.trace(gradient) / 3 * np.eye(3)
    places = np.einsum("nij,kj->nki", to_world, case.array.positions_m)
    return through(case, np.einsum("ij,nkj,nil->nkl", gradient, places, to_world))


def moving_source(distance_m: float) -> Form:
    """Turn a piece of steel at a distance at random from pose to pose."""

    def form(case: SetUp, to_world: FloatArray, rng: np.random.Generator) -> FloatArray:
        place = rng.normal(size=3)
        places = np.einsum("nij,kj->nki", to_world, case.array.positions_m) - distance_m * place / norm(place)
        field = dipole_field(places, rng.normal(size=(len(to_world), 1, 3)))[0]
        return through(case, np.einsum("nki,nil->nkl", field, to_world))

    return form


def own_reading(case: SetUp, _: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Bend each axis: a polynomial of its own reading."""
    part = case.recording.readings_T / np.abs(case.recording.readings_T).max()
    return np.asarray(sum(rng.normal(size=(4, 3)) * part**order for order in (2, 3, 4, 5)))


def direction_of_change(case: SetUp, _: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Give each axis a loop: where it came from, by play operators of three widths."""
    part = case.recording.readings_T / np.abs(case.recording.readings_T).max()
    loops = np.zeros_like(part)
    for width in (0.1, 0.3, 0.6):
        state, weight = part[0], rng.normal(size=(4, 3))
        for row, reading in enumerate(part):
            state = np.clip(state, reading - width, reading + width)
            loops[row] += weight * state
    return np.asarray(loops)


def slow_offset(case: SetUp, _: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Let each offset wander, as with temperature."""
    return np.cumsum(rng.normal(size=case.recording.readings_T.shape), axis=0)


def bending(case: SetUp, to_world: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Turn each sensor a little, in proportion to gravity along and across its arm."""
    turn = np.einsum("kij,nj->nki", rng.normal(size=(4, 3, 3)), to_world[:, 2])
    return through(case, np.cross(turn, case.field_T[:, None]))


def both(first: Form, second: Form) -> Form:
    """Add two laws of equal size."""

    def form(case: SetUp, to_world: FloatArray, rng: np.random.Generator) -> FloatArray:
        forms = [one(case, to_world, rng) for one in (first, second)]
        return np.asarray(sum((one - one.mean(axis=0)) / np.std(one - one.mean(axis=0)) for one in forms))

    return form


OWN = "none: the paper's own model"
LAWS: dict[str, Form] = {
    "noise of each axis": noise,
    "same field at all sensors": common_field,
    "gradient of the site": site_gradient,
    "field that changes, of a source 0.5 m away": moving_source(0.5),
    "field that changes, of a source 1 m away": moving_source(1.0),
    "field that changes, of a source 2 m away": moving_source(2.0),
    "own reading": own_reading,
    "own reading and its direction": direction_of_change,
    "offset that wanders": slow_offset,
    "attitude: arms that bend": bending,
    "same field at all sensors, and offsets that wander": both(common_field, slow_offset),
}


@dataclass(frozen=True)
class Paper:
    """An experiment: what it prints after calibration, its set-up and poses by seed, and its figures."""

    findings: tuple[str, ...]
    set_up: Callable[[int], tuple[SetUp, FloatArray]]
    figures: Callable[[SetUp], FloatArray]


def of_wu(case: SetUp) -> FloatArray:
    """Return the mean absolute errors of the intensity, nT."""
    assert case.recording.scalar_T is not None
    found = published_errors(case.recording, as_published=True)
    return mean_absolute_nT(found.restore(case.recording.readings_T), case.recording.scalar_T)


def of_li2018a(case: SetUp) -> FloatArray:
    """Return the intensities against the artificial platform, nT, and the tensor, nT/m."""
    fields, platform = li2018a.calibrated(case)
    intensity = to_nanotesla(intensity_rms_T(fields["theirs"], norm(platform, axis=1)))
    return np.append(intensity, to_nanotesla(tensor_rms_T_per_m(fields["theirs"], case.baseline_m)))


def of_li2018b(case: SetUp) -> FloatArray:
    """Return the intensities of sensors and platform, nT, and five components of the tensor, nT/m."""
    assert case.recording.scalar_T is not None
    own = orthogonal_fields(case.recording)
    intensity = to_nanotesla(intensity_rms_T(own, case.recording.scalar_T))
    return np.append(intensity, to_nanotesla(tensor_rms_T_per_m(li2018b.turned(own, 36), case.baseline_m))[:5])


def of_chi(case: SetUp) -> FloatArray:
    """Return the tensor, nT/m."""
    fields = chi2017.calibrate(case).restore(case.recording.readings_T)
    return chi2017.tensor_nT_per_m(fields, case.baseline_m)


def chi_set_up(seed: int) -> tuple[SetUp, FloatArray]:
    """Return the set-up of Chi's experiment and its poses."""
    case = chi2017.experiment(seed)
    return case, Rotation.from_quat(case.recording.attitude).as_matrix()


PAPERS = {
    "wu2025": Paper(("Section 4.2, mean absolute error of the intensity after",), turntable, of_wu),
    "li2018a": Paper(("Table 4, TMI, theirs", "Table 5, theirs"), li2018a.experiment, of_li2018a),
    "li2018b": Paper(("Table 5, TMI, theirs", "Table 6, aligned by 36 samples"), li2018b.experiment, of_li2018b),
    "chi2017": Paper(("Table 4, calibrated",), chi_set_up, of_chi),
}


def printed_figures(name: str) -> FloatArray:
    """Return what a paper prints of its experiment after calibration."""
    findings = printed_in(name)["findings"]
    return np.concatenate([findings[each]["paper"] for each in PAPERS[name].findings])


@dataclass(frozen=True, eq=False)
class Draw:
    """A set-up, its poses (N, 3, 3), and the form (N, 4, 3) of a law in it."""

    case: SetUp
    to_world: FloatArray
    form: FloatArray

    def at(self, size_nT: float) -> SetUp:
        """Return the set-up with the law at a size in its readings; what does not change, the bias absorbs."""
        moving = self.form - self.form.mean(axis=0)
        added = from_nanotesla(size_nT) * moving / np.sqrt(np.mean(moving**2))
        recording = replace(self.case.recording, readings_T=self.case.recording.readings_T + added)
        return replace(self.case, recording=recording)


def drawn(name: str, law: str, seeds: int) -> list[Draw]:
    """Return set-ups, and a law in each of them in another form."""
    draws = []
    for seed in range(seeds):
        case, to_world = PAPERS[name].set_up(seed)
        draws.append(Draw(case, to_world, LAWS[law](case, to_world, np.random.default_rng([seed, 7]))))
    return draws


def figures_of(name: str, draws: list[Draw], size_nT: float) -> FloatArray:
    """Return the figures (S, n) with a law of a size."""
    return np.array([PAPERS[name].figures(draw.at(size_nT)) for draw in draws])


def distance(printed: FloatArray, figures: FloatArray) -> float:
    """Return the root mean square of the logarithms of printed (n,) over the median of figures (S, n)."""
    return float(np.sqrt(np.mean(np.log(printed / np.median(figures, axis=0)) ** 2)))


def likelihood(printed: FloatArray, figures: FloatArray) -> tuple[float, float]:
    """Return the log density of printed figures, Gaussian in their logarithms, and the probability of their T²."""
    logs, (seeds, count) = np.log(figures), figures.shape
    covariance = np.atleast_2d(np.cov(logs.T)) + _ROUNDING**2 * np.eye(count)
    away = np.log(printed) - logs.mean(axis=0)
    square = float(away @ solve(covariance, away))
    ratio = square * seeds / (seeds + 1) * (seeds - count) / (count * (seeds - 1))
    return -0.5 * (square + slogdet(covariance)[1]), float(f.sf(ratio, count, seeds - count))


def best_size(name: str, draws: list[Draw]) -> float:
    """Return the size at which the printed figures are most likely, nT: near the one of the smallest distance."""
    printed = printed_figures(name)

    def found(score: Callable[[FloatArray], float], least_nT: float, most_nT: float) -> float:
        bounds = np.log([least_nT, most_nT])
        best = minimize_scalar(
            lambda log_nT: score(figures_of(name, draws, float(np.exp(log_nT)))),
            bounds=bounds, method="bounded", options={"xatol": 0.02},
        )  # fmt: skip
        return float(np.exp(best.x))

    near = found(lambda figures: distance(printed, figures), *_SIZES_NT)
    return found(lambda figures: -likelihood(printed, figures)[0], near / 2, near * 2)


def row(name: str, law: str, size: str, printed: FloatArray, figures: FloatArray, before: float) -> list[str]:
    """Return the cells of a law."""
    after, probability = distance(printed, figures), likelihood(printed, figures)[1]
    low, high = np.percentile(figures, [5, 95], axis=0)
    within = f"{np.sum((low <= printed) & (printed <= high))} of {len(printed)}"
    spans = " ".join(f"{least:.3g}–{most:.3g}" for least, most in zip(low, high, strict=True))
    words = [" ".join(f"{each:.3g}" for each in values) for values in (printed, np.median(figures, axis=0))]
    chance = f"{probability:.2g}" if probability >= 1e-3 else "< 0.001"
    return [name, law, size, f"{np.exp(after):.2f}", f"{after / before:.0%}", chance, within, *words, spans]


def laws_of(name: str, seeds: int) -> tuple[list[list[str]], str, float]:
    """Return the rows of a paper, and the law that makes its figures most likely, with its size."""
    printed = printed_figures(name)
    figures = figures_of(name, drawn(name, "noise of each axis", seeds), 0.0)
    before = distance(printed, figures)
    rows, found = [row(name, OWN, "", printed, figures, before)], []
    for law in track(LAWS, description=name):
        draws = drawn(name, law, seeds)
        size_nT = best_size(name, draws)
        figures = figures_of(name, draws, size_nT)
        found.append((likelihood(printed, figures)[0], law, size_nT))
        rows.append(row(name, law, f"{size_nT:.3g}", printed, figures, before))
    _, law, size_nT = max(found)
    return rows, law, size_nT


def coil_rows(seeds: int) -> list[list[str]]:
    """Return the rows of the coil of Wu 2025: as modelled, and over a table of metal."""
    runs = [simulate(seed) for seed in range(seeds)]
    name = "Section 4.2, RMSE of the coil's position after"
    printed = np.array(printed_in("wu2025")["findings"][name]["paper"])
    own, over_metal = (np.array([run[key][0] for run in runs]) for key in (name, f"{name}, over a metal table"))
    before = distance(printed, own)
    laws = {OWN: own, "rate: eddy currents in the table": over_metal}
    return [row("wu2025, coil", law, "", printed, figures, before) for law, figures in laws.items()]


def diagnosed(name: str, law: str, size_nT: float, cases: int) -> list[list[str]]:
    """Return what ``tam diagnose`` says of recordings with a law, by what else is recorded."""
    answers: dict[str, Counter[str]] = {"without attitude": Counter(), "with attitude": Counter()}
    for draw in track(drawn(name, law, cases), description=f"diagnosing {name}"):
        case = draw.at(size_nT)
        quaternion = Rotation.from_matrix(draw.to_world).as_quat()
        answers["without attitude"][answer(replace(case.recording, attitude=None), case.array)] += 1
        answers["with attitude"][answer(replace(case.recording, attitude=quaternion), case.array)] += 1
    return [
        [name, law, recorded, "; ".join(f"{count} × {said}" for said, count in counts.most_common())]
        for recorded, counts in answers.items()
    ]


def answer(recording: Recording, array: Array) -> str:
    """Return verdict, law, place and cause of a diagnosis, in words."""
    try:
        gap = diagnose(recording, array.with_noise(array.with_stated_noise().vector_noise_T, SCALAR_NOISE_T))
    except Refused as refusal:
        return f"refused: {str(refusal)[:80]}"
    answered = gap_to_mapping(gap)
    laws = [f"{one['law']} in {'/'.join(map(str, one['sensors']))}" for one in answered["signature"][:1]]
    causes = [one["effect"] for one in answered["causes"]]
    return f"{answered['verdict']}: {', '.join(laws) or 'no law'}{' by ' + ' + '.join(causes) if causes else ''}"


@click.command(help=__doc__)
@click.option("--seeds", default=40, show_default=True, type=click.IntRange(11), help="More than ten figures.")
@click.option("--diagnosed", "cases", default=10, show_default=True, help="Recordings of each paper to diagnose.")
def main(seeds: int, cases: int) -> None:
    """Run the benchmark."""
    rows, answers = coil_rows(seeds), []
    for name in PAPERS:
        found, law, size_nT = laws_of(name, seeds)
        rows += found
        answers += diagnosed(name, law, size_nT, cases)
        if name == "wu2025":
            common = "same field at all sensors"
            size_nT = next(float(cells[2]) for cells in found if cells[1] == common)
            answers += diagnosed(name, common, size_nT, cases)
    console = Console(width=260)
    for header, table_rows in ((HEADER, rows), (DIAGNOSED, answers)):
        table = Table(*header)
        for cells in table_rows:
            table.add_row(*cells)
        console.print(table)
    with write_whole(RESULTS) as path, path.open("w", encoding="utf-8", newline="") as file:
        file.write(f"# python benchmarks/papers_gap.py --seeds {seeds} --diagnosed {cases}\n")
        csv.writer(file, lineterminator="\n").writerows([HEADER, *rows, DIAGNOSED, *answers])


if __name__ == "__main__":
    main()
