"""The ledger of the diagnosis' constants: value, reason, kind, and what halving and doubling each does to the figures.

Run ``python benchmarks/gap_constants.py [--quick] [--only NAME]… [--page PAGE]``. Some short recordings of the blind
check, made once, are diagnosed as the code stands and with one constant halved and doubled wherever it is imported. Of
those whose diagnosis calls a function that reads the constant, an effect's is tried on those of the effect itself and
three others. ``--quick`` runs nothing; ``--only`` measures the constants whose name contains some letters. What was
measured stays in ``results/gap_constants.csv`` until the value changes. ``gap_constants.md`` is written anew.
"""

import csv
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from cProfile import Profile
from dataclasses import dataclass
from math import isnan
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from types import CodeType
from typing import Any

import click
from constants import (
    KINDS,
    PACKAGE,
    ROOMS,
    Constant,
    find_constants,
    module_of,
    modules_with,
    unnamed_in_comparisons,
)
from rich.progress import track

from tam_calibration.effects.library import installed_effects
from tam_calibration.files.text_files import write_whole
from tam_calibration.gap import diagnose
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.recordings import read_array, read_recording
from tam_calibration.results.results_json import gap_to_mapping
from tam_validation.blind.case import make_case
from tam_validation.blind.case_plan import CasePlan
from tam_validation.blind.figures import is_mixture_found
from tam_validation.blind.folder import write_case
from tam_validation.blind.outcome import Outcome

RESULTS = Path(__file__).parent / "results" / "gap_constants.csv"
PAGE = Path(__file__).parent / "gap_constants.md"
SEED = 1207
"""Of recordings that nothing is tuned on or judged by."""

SAMPLES = 800
"""Of a recording: few enough for a thousand diagnoses, enough to see a third of a noise floor."""

FACTORS = {"halved": 0.5, "doubled": 2.0}
"""A factor of two is what a constant without a measured value is uncertain by."""

OTHERS = 3
"""Recordings without the constant's own effect that are diagnosed too, spread over those that read it."""

SINGLES = {
    0.3: ("temperature_drift", "time_skew", "noise_excess", "hysteresis"),
    1.0: ("bias_jump", "current_interference", "periodic_interference", "quantization", "outliers", "stale_samples"),
    3.0: ("saturation", "eddy_current", "ambient_gradient", "scalar_heading_error", "crosstalk", "timing_jitter"),
}
"""Effects by the noise floors of their gap."""

PLANS = (
    *(CasePlan("single", (effect,), (gap,), SAMPLES) for gap, effects in SINGLES.items() for effect in effects),
    *(CasePlan("clean", (), (), SAMPLES) for _ in range(2)),
    *(CasePlan("outside", (effect,), (1.0,), SAMPLES) for effect in ("random_walk_bias", "stiction", "gain_wander")),
    *(CasePlan("mixed", (effect, "gain_wander"), (2.0, 1.0), SAMPLES) for effect in ("temperature_drift", "bias_jump")),
    CasePlan("pair", ("bias_jump", "current_interference"), (1.5, 1.5), SAMPLES),
    CasePlan("pair", ("nonlinearity", "outliers"), (1.5, 1.5), SAMPLES),
)
"""Single causes, two recordings without any, three with one outside the library, two with one beside, two pairs."""

VERDICTS = {"single": "explained", "pair": "explained", "clean": "no_gap", "outside": "unexplained"}
HEADER = ("constant", "value", "change", "cases", "answers", "first", "verdict", "clean", "seconds", "seconds_before")


@dataclass(frozen=True, eq=False)
class Given:
    """A recording to diagnose, and its key."""

    key: dict[str, Any]
    recording: Recording
    array: Array


@dataclass(frozen=True)
class Answer:
    """What a diagnosis says and whether it is right; None where a case does not ask it."""

    said: tuple[Any, ...]
    first: bool | None
    verdict: bool
    clean: bool | None
    seconds: float


@click.command()
@click.option("--quick", is_flag=True, help="Write the page without running anything.")
@click.option("--only", multiple=True, metavar="NAME", help="Measure the constants whose name contains this.")
@click.option("--page", type=click.Path(path_type=Path), default=PAGE, show_default=True)
def main(quick: bool, only: tuple[str, ...], page: Path) -> None:
    """Measure constants and write the ledger."""
    constants = find_constants()
    chosen = [one for one in constants if not only or any(name in one.key for name in only)]
    rows = kept(constants)
    for row in () if quick else measure(chosen):
        rows[row["constant"], row["change"]] = row
        write_results(rows)
    with write_whole(page) as beside:
        beside.write_text(text(constants, rows), encoding="utf-8")


def measure(constants: Sequence[Constant]) -> Iterator[dict[str, str]]:
    """Yield what halving and doubling constants does, a row for each change."""
    given = [make(plan, number) for number, plan in enumerate(track(PLANS, "making the recordings"))]
    reached = [names_reached(one) for one in track(given, "what each diagnosis reads")]
    before = [answer(one) for one in track(given, "as the code stands")]
    for constant in track(constants, "halved and doubled"):
        cases = cases_of(constant, given, reached)
        for change, factor in FACTORS.items() if cases else ():
            with changed(constant, factor):
                after = [answer(given[case]) for case in cases]
            yield row_of(constant, change, [before[case] for case in cases], after)
        if not cases:
            yield row_of(constant, "halved", [], [])


def make(plan: CasePlan, number: int) -> Given:
    """Make one recording, as ``tam blind make`` does."""
    case = make_case(plan, SEED, number)
    with TemporaryDirectory() as folder:
        write_case(Path(folder), case)
        array = read_array(Path(folder, "spec.yaml"))
        return Given(case.key, read_recording(Path(folder, "data.csv"), array.sensor_count), array)


def names_reached(given: Given) -> set[tuple[str, str]]:
    """Return the modules and names that the functions called by a diagnosis read."""
    profile = Profile(builtins=False)
    profile.runcall(answer, given)
    called = [entry.code for entry in profile.getstats() if isinstance(entry.code, CodeType)]
    own = [code for code in called if Path(code.co_filename).is_relative_to(PACKAGE)]
    return {(module_of(Path(code.co_filename)), name) for code in own for name in code.co_names}


def cases_of(constant: Constant, given: Sequence[Given], reached: Sequence[Collection[tuple[str, str]]]) -> list[int]:
    """Return the cases on which a constant is tried."""
    readers = {(module.__name__, constant.name) for module in modules_with(constant)}
    all_reading = [case for case, names in enumerate(reached) if readers & set(names)]
    effects = {name for name, effect in installed_effects().items() if type(effect).__module__ == constant.module}
    if not effects:
        return all_reading
    own = [case for case in all_reading if effects & {one["effect"] for one in given[case].key["effects"]}]
    others = [case for case in all_reading if case not in own]
    return own + others[:: max(len(others) // OTHERS, 1)][:OTHERS]


@contextmanager
def changed(constant: Constant, factor: float) -> Iterator[None]:
    """Change a constant wherever it is imported, for a while."""
    modules = list(modules_with(constant))
    for module in modules:
        setattr(module, constant.name, constant.scaled(factor))
    try:
        yield
    finally:
        for module in modules:
            setattr(module, constant.name, constant.value)


def answer(given: Given) -> Answer:
    """Diagnose a recording; a defect is an answer too."""
    began = process_time()
    try:
        told = gap_to_mapping(diagnose(given.recording, given.array))
    except Exception as problem:  # a constant out of its range may break anything
        told = {"verdict": "error", "why": str(problem)}
    one = Outcome("", given.key, told)
    size = (told.get("gap") or {}).get("before"), (told.get("gap") or {}).get("closed")
    said = (one.verdict, *one.named, *(f"{value:.3g}" for value in size if value is not None and not isnan(value)))
    is_clean = one.kind == "clean"
    is_right = is_mixture_found(one) if one.kind == "mixed" else one.verdict == VERDICTS[one.kind]
    first = one.first_is_right if one.kind in ("single", "pair", "mixed") else None
    return Answer(said, first, is_right, is_right if is_clean else None, process_time() - began)


def row_of(constant: Constant, change: str, before: Sequence[Answer], after: Sequence[Answer]) -> dict[str, str]:
    """Return the row of a constant: answers that are others, and by how many more are right."""

    def more(figure: str) -> int:
        return sum(bool(getattr(one, figure)) for one in after) - sum(bool(getattr(one, figure)) for one in before)

    others = sum(one.said != other.said for one, other in zip(before, after, strict=True))
    seconds = [sum(one.seconds for one in answers) for answers in (after, before)]
    figures = [len(after), others, more("first"), more("verdict"), more("clean"), *(f"{one:.1f}" for one in seconds)]
    return dict(zip(HEADER, map(str, (constant.key, constant.told, change, *figures)), strict=True))


def kept(constants: Sequence[Constant]) -> dict[tuple[str, str], dict[str, str]]:
    """Return the rows measured before of constants that still have the same value."""
    if not RESULTS.exists():
        return {}
    values = {one.key: one.told for one in constants}
    with RESULTS.open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if values.get(row["constant"]) == row["value"]]
    return {(row["constant"], row["change"]): row for row in rows}


def write_results(rows: Mapping[tuple[str, str], Mapping[str, str]]) -> None:
    """Write all that was measured."""
    with write_whole(RESULTS) as beside, beside.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, HEADER, lineterminator="\n")
        writer.writeheader()
        writer.writerows(row for _, row in sorted(rows.items()))


def text(constants: Sequence[Constant], rows: Mapping[tuple[str, str], Mapping[str, str]]) -> str:
    """Return the page."""
    measured = {key for key, _ in rows}
    idle = [f"`{one.key}`" for one in constants if one.key in measured and not moves(one, rows)]
    counts = Counter((one.module.split(".")[1], one.kind) for one in constants)
    table = [[kind, *(str(counts[room, kind]) for room in ROOMS)] for kind in KINDS]
    totals = ["all", *(str(sum(counts[room, kind] for kind in KINDS)) for room in ROOMS)]
    parts = [
        "# The constants of the diagnosis",
        "This page lists every number that the diagnosis uses, with its reason and what halving and doubling it does. "
        "`python benchmarks/gap_constants.py` writes it and runs for hours; `--only NAME` measures some constants, "
        "`--quick` none. "
        f"Measured so far: {len(measured)} of {len(constants)}.",
        markdown(("kind", *(f"`{room}/`" for room in ROOMS)), [*table, totals]),
        f"{unnamed_in_comparisons()} further numbers other than 0 to 3 are compared without a name. "
        "`benchmarks/constants.py` assigns the kinds: a *decision* is compared with a function of the data, so it can "
        "change an answer. The others can do so only through numerics.",
        f"The figures are those of {len(PLANS)} recordings of {SAMPLES} samples: sixteen with one cause, of 0.3, 1 and "
        "3 noise floors, two with none, three with a cause outside the library, two with a known cause beside one, two "
        "with two causes. *Answers* counts the diagnoses whose verdict, causes or sizes change, of those tried. Then "
        "follow how many more or fewer first causes and verdicts are right (clean recordings also separately), and the "
        "ratio of processor times. For a fraction p between 0.9 and 1, 1 - p is halved and doubled. So few recordings "
        "show what a constant can do, not that it has no effect elsewhere.",
        f"No effect, or not reached in these recordings: {', '.join(idle) or 'none of those measured'}.",
    ]
    by_kind = defaultdict(list)
    for one in constants:
        by_kind[one.kind].append(one)
    for kind in KINDS:
        lines = [line_of(one, rows) for one in by_kind[kind]]
        parts += [f"## {kind.capitalize()}", markdown(("constant", "value", "reason", *FACTORS), lines)]
    return "\n\n".join(parts) + "\n"


def moves(constant: Constant, rows: Mapping[tuple[str, str], Mapping[str, str]]) -> bool:
    """Whether any answer is another with a constant halved or doubled."""
    return any(rows[constant.key, change]["answers"] != "0" for change in FACTORS if (constant.key, change) in rows)


def line_of(constant: Constant, rows: Mapping[tuple[str, str], Mapping[str, str]]) -> list[str]:
    """Return the line of a constant."""
    effects = [effect_of(rows.get((constant.key, change))) for change in FACTORS]
    if rows.get((constant.key, "halved"), {}).get("cases") == "0":
        effects = ["not reached"] * len(FACTORS)
    return [f"`{constant.key}`", constant.told, constant.reason.replace("|", "∣") or "–", *effects]


def effect_of(row: Mapping[str, str] | None) -> str:
    """Return what a change did, in words."""
    if row is None:
        return ""
    ratio = float(row["seconds"]) / max(float(row["seconds_before"]), 0.1)
    right = [f"{name} {int(row[name]):+d}" for name in ("first", "verdict", "clean") if row[name] != "0"]
    return ", ".join([f"answers {row['answers']} of {row['cases']}", *right, f"time × {ratio:.2g}"])


def markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table."""
    return "\n".join(f"| {' | '.join(line)} |" for line in [header, ["---"] * len(header), *rows])


if __name__ == "__main__":
    main()
