"""Whether the intervals of located sources hold what they say, beside all that a pass may bring.

Run ``python benchmarks/localization_grid.py [--sweep 500] [--runs 500]``: a platform of 1 m/s that sways by 6° passes
dipoles of 30 to 500 A m² at 2.5 to 5 m with a cross of 0.5 m, 150 samples at 2.5 Hz. Of one or two sources of
structural index 1 to 3 so many passes each are drawn from the whole product of noise 0.03 to 3 nT, attitude 0 to 0.3°,
gradient 0 to 5 nT/m and velocity error 0 to 3 %; attitude, gradient and velocity are each exact in a third of them, and
figures are pooled. Then from a middle cell each condition is changed by itself, then all at once. Figures are written
while the passes go on: a run that is ended early says of how many they are. The dipoles of a pass are located by
``find_targets``, with the velocity's standard error that `tam locate --velocity` takes where none is stated, and by
each sample. Lines of current and of dipoles, structural index 1 and 2, are crossed at the same distances and located by
each sample; the nearest point of the line is what is sought. Of dipoles and currents the regional field of samples by
themselves is that of the run, of lines of dipoles it is known to 140 nT as IGRF is. What is refused counts as refused.
``--others`` are passes by a smaller array, nearer, on a curve, which nothing was tuned on.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import click
import numpy as np
from asked import Figure, show
from numpy.linalg import norm
from rich.progress import track as progress
from scipy.spatial.transform import Rotation

from tam_calibration.correction.calibration import Calibration
from tam_calibration.files.text_files import write_whole
from tam_calibration.localization.euler import DIPOLE_INDEX, DIPOLES_INDEX
from tam_calibration.localization.locate import locate_run
from tam_calibration.localization.targets import find_targets, path_in
from tam_calibration.localization.turned_samples import Regional, Samples, regional_of
from tam_calibration.model.array import UNIT_TENSORS, Array
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.geomagnetic_field import LOCAL_VARIANCE_T2
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors, noise_floor
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla
from tam_calibration.sources.dipole import Dipole

RESULTS = Path(__file__).parent / "results" / "localization_grid.csv"
_REGIONAL_T = np.array([1e-6, 20e-6, -45e-6])
"""A field of middle latitudes, east, north, up."""

_TIME_S = np.arange(150) / 2.5
"""A minute, so dense that the nearest part of a pass has tens of samples."""

_NINETY_FIVE, _FAR_OFF = 1.96, 5.0
"""Standard errors within which 95 % of normal errors lie, and beyond which no answer may be."""

_WRITTEN = 20
"""Passes after which the figures are written again."""

_NAMES = {1: "line(s) of current", 2: "line(s) of dipoles", 3: "dipole(s)"}
_MU0_OVER_2_PI = 2e-7
"""μ₀ / 2 π, T m / A."""
_CURRENT_A = 10.0
"""Of a cable: 0.4 µT at 5 m."""


@dataclass(frozen=True)
class Way:
    """How sources are passed: baseline and distances [m], part of the strength, sway and turn of the platform [rad]."""

    baseline_m: float = 0.5
    distances_m: tuple[float, float] = (2.5, 5.0)
    strength: float = 1.0
    sway: float = 0.1
    turn: float = 0.0

    def path_m(self, straight_m: FloatArray) -> FloatArray:
        """Return a straight path (N, 3) bent to an arc that turns so far, through the same middle."""
        if not self.turn:
            return straight_m
        middle = straight_m[len(straight_m) // 2]
        radius = norm(straight_m[-1] - straight_m[0]) / self.turn
        x, y, z = (straight_m - middle).T
        bent = np.column_stack([radius * np.sin(x / radius), y + radius * (1 - np.cos(x / radius)), z])
        return np.asarray(middle + bent)


OTHER = Way(0.3, (1.2, 2.2), 0.08, 0.25, 1.5)
"""Nothing was tuned on it: smaller, nearer, on a curve, by sources whose field is as strong."""


@dataclass(frozen=True)
class Cell:
    """The conditions of a pass: noise [nT], attitude [deg], gradient [nT/m], velocity error [1], sources and index."""

    noise_nT: float = 0.3
    attitude_deg: float = 0.0
    gradient_nT_per_m: float = 2.0
    velocity_error: float = 0.01
    sources: int = 1
    index: int = 3

    way: "Way" = Way()

    @property
    def words(self) -> str:
        """What is passed, in words."""
        return (
            f"{self.noise_nT:g} nT, attitude {self.attitude_deg:g}°, gradient {self.gradient_nT_per_m:g} nT/m, "
            f"velocity {100 * self.velocity_error:g} %, {self.what}"
        )

    @property
    def what(self) -> str:
        """How many of which source."""
        return f"{self.sources} {_NAMES[self.index].replace('(s)', 's' * (self.sources > 1))}"


MIDDLE = Cell()
CELLS = (
    *(Cell(noise, 0.0, 0.0, 0.0, 1, index) for index in (1, 2) for noise in (0.03, 0.3, 3.0)),
    MIDDLE,
    *(replace(MIDDLE, noise_nT=noise) for noise in (0.03, 3.0)),
    *(replace(MIDDLE, attitude_deg=angle) for angle in (0.1, 0.3)),
    *(replace(MIDDLE, gradient_nT_per_m=gradient) for gradient in (0.0, 5.0)),
    *(replace(MIDDLE, velocity_error=error) for error in (0.0, 0.03)),
    replace(MIDDLE, sources=2),
    Cell(0.03, 0.3, 5.0, 0.03),
    Cell(3.0, 0.3, 5.0, 0.03),
    Cell(0.03, 0.1, 5.0, 0.03, 2),
    Cell(1.0, 0.1, 0.0, 0.0),
)
"""Lines beside noise alone; of dipoles each condition by itself to its ends, then corners of several at once."""

KINDS = ((1, 3), (1, 1), (1, 2), (2, 1), (2, 2), (2, 3))
"""How many sources of which structural index the whole product has."""


@dataclass(frozen=True, eq=False)
class Line:
    """A line through a point along a unit vector: of a current [A], or of a moment for each metre [A m] across it."""

    position_m: FloatArray
    along: FloatArray
    current_A: float
    moment_Am: FloatArray

    def field_T(self, points_m: FloatArray) -> FloatArray:
        """Return the field (..., 3) at points (..., 3), tesla."""
        across = points_m - self.nearest_m(points_m)
        square = np.sum(across**2, axis=-1, keepdims=True)
        of_current = self.current_A * np.cross(self.along, across) / square
        of_moment = (2 * across * (across @ self.moment_Am)[..., None] / square - self.moment_Am) / square
        field: FloatArray = _MU0_OVER_2_PI * (of_current + of_moment)
        return field

    def nearest_m(self, points_m: FloatArray) -> FloatArray:
        """Return the points (..., 3) of the line that are nearest to points (..., 3), metres."""
        nearest: FloatArray = self.position_m + ((points_m - self.position_m) @ self.along)[..., None] * self.along
        return nearest


@dataclass(frozen=True, eq=False)
class Pass:
    """The fields (N, K, 3) that were read, the attitudes that were reported, and the sources that were passed."""

    fields_T: FloatArray
    array: Array
    attitude: FloatArray
    path_m: FloatArray
    sources: list[Dipole | Line]
    index: int
    known: Regional

    @classmethod
    def of(cls, cell: Cell, generator: np.random.Generator) -> "Pass":
        """Return one pass, everything random that a cell does not say."""
        noise, attitude_noise = from_nanotesla(cell.noise_nT), from_degrees(cell.attitude_deg)
        way = cell.way
        array = Array.cross(way.baseline_m, vector_noise_T=noise)
        velocity = np.array([1.0, 0.0, 0.0])
        true_velocity = velocity + cell.velocity_error * generator.standard_normal(3)
        path = way.path_m(np.outer(_TIME_S, true_velocity))
        angles = np.outer(_TIME_S, [0.2, 0.33, 0.5]) + generator.uniform(0, 6, 3)
        sway = Rotation.from_euler("zyx", way.sway * np.sin(angles))
        points = path[:, None] + np.einsum("nij,kj->nki", sway.as_matrix(), array.positions_m)
        tensor = np.tensordot(generator.standard_normal(5), UNIT_TENSORS, 1)
        tensor *= from_nanotesla(cell.gradient_nT_per_m) / np.abs(np.linalg.eigvalsh(tensor)).max()
        sources = [_source(generator, cell.index, way) for _ in range(cell.sources)]
        world = _REGIONAL_T + points @ tensor + sum(each.field_T(points) for each in sources)
        fields = np.einsum("nji,nkj->nki", sway.as_matrix(), world) + noise * generator.standard_normal(world.shape)
        reported = sway * Rotation.from_rotvec(attitude_noise * generator.standard_normal((len(_TIME_S), 3)))
        stated_T = _REGIONAL_T + generator.multivariate_normal(np.zeros(3), 1e18 * LOCAL_VARIANCE_T2) / 1e9
        known = Regional(stated_T, attitude_noise, LOCAL_VARIANCE_T2)
        return cls(fields, array, reported.as_quat(), path, sources, cell.index, known)

    def together(self) -> FloatArray:
        """Return the pulls (S, 3) of the dipoles that all samples show."""
        none = SensorErrors.none(self.array.sensor_count)
        array = self.array.with_stated_noise()
        floor = noise_floor(none, array, 1e-10)
        size = float(np.linalg.norm(_REGIONAL_T))
        known = np.zeros((12 * self.array.sensor_count,) * 2)
        exact = Calibration(
            "maximum_likelihood", array, False, none, known, True, size, floor, floor, floor, 100, (0.0, 1.0), 1.0
        )
        recording = Recording(_TIME_S, self.fields_T, attitude=self.attitude)
        path = path_in(recording, np.array([1.0, 0.0, 0.0]))
        targets = find_targets(recording, exact, path, self.known.attitude_noise).targets
        if not targets:
            raise Refused("no target")
        places = np.array([each.position_m for each in targets])
        errors = np.array([each.standard_errors_m for each in targets])
        return self._pulls(places, errors, places)

    def one_by_one(self) -> FloatArray:
        """Return the pulls (n, 3) of the samples that are located by themselves, at the true places."""
        attitude, noise = self.attitude, self.known.attitude_noise
        outputs = self.fields_T.reshape(len(self.fields_T), -1) @ self.array.operator.T
        assert self.array.vector_noise_T is not None
        covariance = self.array.operator * np.repeat(self.array.vector_noise_T**2, 3) @ self.array.operator.T
        prior = self.known
        if self.index != DIPOLE_INDEX and noise:
            raise Refused("lines are located with an exact attitude alone")
        if self.index != DIPOLES_INDEX:
            prior = regional_of(outputs, attitude, noise)
        world, _ = locate_run(Samples(outputs, self.array, covariance, attitude, self.index), prior)
        at = world.is_located
        errors = np.sqrt(np.diagonal(world.position_covariance_m2[at], axis1=1, axis2=2))
        return self._pulls(world.position_m[at] + self.path_m[at], errors, self.path_m[at])

    def _pulls(self, places_m: FloatArray, errors_m: FloatArray, seen_from_m: FloatArray) -> FloatArray:
        """Return the errors over standard errors of places (n, 3), each of the nearest source as it is seen."""
        true = [each.nearest_m(seen_from_m) if isinstance(each, Line) else each.position_m for each in self.sources]
        off = np.array([places_m - place for place in true])
        nearest = np.linalg.norm(off, axis=2).argmin(axis=0)
        pulls: FloatArray = off[nearest, np.arange(len(places_m))] / errors_m
        return pulls


def _source(generator: np.random.Generator, index: int, way: Way) -> Dipole | Line:
    angle, distance = generator.uniform(-1, 1), generator.uniform(*way.distances_m)
    place = np.array([_TIME_S[-1] / 2 + generator.uniform(-6, 6), distance * np.sin(angle), -distance * np.cos(angle)])
    moment = generator.standard_normal(3)
    moment *= way.strength * 10 ** generator.uniform(1.5, 2.7) / np.linalg.norm(moment)
    if index == DIPOLE_INDEX:
        return Dipole(place, moment)
    heading = generator.uniform(0.8, 2.3)
    along = np.array([np.cos(heading), np.sin(heading), 0.0])
    across = moment - (moment @ along) * along
    return Line(place, along, _CURRENT_A, np.zeros(3)) if index == 1 else Line(place, along, 0.0, across)


_Pulls = tuple[FloatArray | None, FloatArray | None]
"""Of one pass: of all samples together, None where that is refused, and of each by itself."""


def _judged(cell: Cell, seed: tuple[int, ...], with_track: bool) -> _Pulls:
    made = Pass.of(cell, np.random.default_rng(seed))
    together = one_by_one = None
    if with_track and cell.index == DIPOLE_INDEX:
        with suppress(Refused):
            together = made.together()
    with suppress(Refused):
        one_by_one = made.one_by_one()
    return together, one_by_one


def _of_cell(seed: int, with_track: bool, number: int, run: int) -> _Pulls:
    return _judged(CELLS[number], (seed, number, run), with_track)


def _of_product(seed: int, with_track: bool, kind: int, run: int) -> _Pulls:
    number = len(CELLS) + kind
    return _judged(_drawn((seed, number, run), kind), (seed, number, run, 1), with_track)


def _of_others(seed: int, kind: int, run: int) -> _Pulls:
    number = len(CELLS) + len(KINDS) + kind
    return _judged(replace(_drawn((seed, number, run), kind), way=OTHER), (seed, number, run, 1), False)


def _drawn(seed: tuple[int, ...], kind: int) -> Cell:
    """Return conditions out of the whole product."""
    generator = np.random.default_rng(seed)
    attitude, gradient, velocity = generator.uniform(0, [0.3, 5.0, 0.03]) * (generator.uniform(size=3) > 1 / 3)
    noise = 10 ** generator.uniform(np.log10(0.03), np.log10(3))
    return Cell(noise, attitude, gradient, velocity, *KINDS[kind])


@dataclass(frozen=True)
class _Row:
    """What is passed, how often, and what makes the pulls of one pass."""

    what: str
    passes: int
    judge: Callable[[int], _Pulls]
    has_track: bool

    def figures(self, results: Sequence[_Pulls]) -> Iterator[Figure]:
        """Yield the figures of so many results."""
        together, one_by_one = zip(*results, strict=True)
        if self.has_track:
            yield from _figures(self.what, "track", together)
        yield from _figures(self.what, "each sample", one_by_one)


def _figures(what: str, method: str, each_run: Sequence[FloatArray | None]) -> Iterator[Figure]:
    """Yield how many passes are refused, or have no sample that is located, and the figures of the others."""
    parts = [part for part in each_run if part is not None and len(part)]
    yield Figure(what, method, "passes", len(each_run))
    yield Figure(what, method, "refused", 1 - len(parts) / len(each_run))
    if parts:
        pulls = np.concatenate(parts)
        covered = float((np.abs(pulls) < _NINETY_FIVE).mean())
        yield Figure(what, method, "95 % intervals that cover", covered, _spread(parts, covered), (0.93, 0.97))
        yield Figure(what, method, "beyond 5 σ", float((np.abs(pulls) > _FAR_OFF).mean()), asked=(0.0, 0.001))


def _spread(parts: Sequence[FloatArray], covered: float) -> float:
    """Return the standard error of a ratio whose passes, not pulls, are independent."""
    counts = np.array([part.size for part in parts])
    hits = np.array([(np.abs(part) < _NINETY_FIVE).sum() for part in parts])
    return float(np.sqrt(np.sum((hits - covered * counts) ** 2)) / counts.sum())


@click.command(help=__doc__)
@click.option("--sweep", default=500, show_default=True, help="Passes of each kind from the whole product; 0 none.")
@click.option("--runs", default=500, show_default=True, help="Passes of each cell; 0 none.")
@click.option("--others", default=0, show_default=True, help="Passes of each kind in another way, by samples alone.")
@click.option("--track/--no-track", default=True, show_default=True, help="Whether dipoles are located along a track.")
@click.option("--seed", default=17, show_default=True, help="Of all random numbers.")
@click.option("--processes", type=int, help="That work side by side; as many as there are cores by default.")
def main(sweep: int, runs: int, others: int, track: bool, seed: int, processes: int | None) -> None:
    """Run the benchmark."""
    whats = [Cell(sources=sources, index=index).what for sources, index in KINDS]
    judges = [partial(_of_product, seed, track, kind) for kind in range(len(KINDS))]
    rows = [
        _Row(f"the whole product, {what}", sweep, judge, track and index == DIPOLE_INDEX)
        for what, judge, (_, index) in zip(whats, judges, KINDS, strict=True)
    ]
    rows += [
        _Row(f"passed in another way, {what}", others, partial(_of_others, seed, kind), False)
        for kind, what in enumerate(whats)
    ]
    rows += [
        _Row(cell.words, runs, partial(_of_cell, seed, track, number), track and cell.index == DIPOLE_INDEX)
        for number, cell in enumerate(CELLS)
    ]
    options = f"--sweep {sweep} --others {others} --runs {runs} --seed {seed}{'' if track else ' --no-track'}"
    command = f"# python benchmarks/localization_grid.py {options}"
    done: list[Figure] = []
    with ProcessPoolExecutor(processes) as pool:
        for row in rows:
            results: list[_Pulls] = []
            for result in progress(pool.map(row.judge, range(row.passes)), description=row.what, total=row.passes):
                results.append(result)
                if len(results) % _WRITTEN == 0 or len(results) == row.passes:
                    _write(command, [*done, *row.figures(results)])
            done += row.figures(results) if results else []
    show(done, f"Intervals of located sources, {sweep} passes of each kind, {runs} of each cell", "method")


def _write(command: str, figures: Sequence[Figure]) -> None:
    lines = [command, "case,method,figure,value,standard_error,asked,met", *(figure.line for figure in figures)]
    with write_whole(RESULTS) as path:
        path.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
