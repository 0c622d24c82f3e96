"""How often the vehicle's own field is named: where it is there, and where it is not.

Run ``python benchmarks/platform_field_named.py KIND --cases N --seed SEED``. Cases are those of the check on withheld
effects, given to the diagnosis as files. KIND is

- ``same``: the vehicle of that check, on which rules of the diagnosis were tuned with other seeds;
- ``neighbours``: effects that the field may be mistaken for, each at work alone, of which each should be named;
- ``clean``: nothing at all, read by four sensors and a scalar; three recordings in four have channels of currents and
  actuators beside them.

Of all but the last 0.3, 1, 3 and 30 noise floors are seen in turn, and the cases are counted in which the cause is
named first; of the last those in which a gap, a cause, or this field is told.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import click
import numpy as np
from rich.progress import track

from tam_calibration.files.text_files import write_whole
from tam_calibration.gap import diagnose
from tam_calibration.model.units import FloatArray
from tam_calibration.recordings import read_array, read_recording
from tam_calibration.results.results_json import gap_to_mapping
from tam_validation.blind.case import Case, make_case
from tam_validation.blind.case_plan import GAPS, CasePlan
from tam_validation.blind.folder import write_case
from tam_validation.blind.outcome import NO_GAP, Outcome
from tam_validation.blind.processes import draw_load, draw_wander
from tam_validation.blind.rates import Rate

RESULTS = Path(__file__).parent / "results" / "platform_field_named.csv"
NAME = "platform_field"
KINDS = {
    "same": [NAME],
    "neighbours": ["eddy_current", "bias_jump", "geomagnetic_drift", "current_interference"],
}
Drawn = Callable[[np.random.Generator, FloatArray], FloatArray]
Rows = Iterator[tuple[str, str, float]]


def of_cases(names: list[str], count: int, seed: int) -> Rows:
    """Yield of all, by cause and by gap, in how many cases the cause is named first, and what is left."""
    outcomes: dict[tuple[str, float], list[Outcome]] = {}
    for number in track(range(1, count + 1), "cases"):
        gap, name = (*GAPS, 30.0)[number % 4], names[(number - 1) // 4 % len(names)]
        case = make_case(CasePlan("single" if gap in GAPS else "large", (name,), (gap,)), seed, number)
        outcomes.setdefault((name, gap), []).append(answered(f"{number} {name}", case))
    everything = [one for some in outcomes.values() for one in some]
    yield from named_first("all", everything)
    yield "all", "amplitude left, median", float(np.median([one.amplitude_left for one in everything]))
    for part in (*names, *GAPS, 30.0):
        some = [one for key, each in outcomes.items() if part in key for one in each]
        yield from named_first(part if isinstance(part, str) else f"{part:g} noise floors", some)


def named_first(what: str, outcomes: list[Outcome]) -> Rows:
    """Yield how many cases there are, in how many the cause is named first, and Wilson's interval of the part."""
    rate = Rate.of(one.first_is_right for one in outcomes)
    yield what, "cases", rate.cases
    yield what, "named first", rate.hits
    yield what, "named first, part at least", rate.interval[0]
    yield what, "named first, part at most", rate.interval[1]


def of_clean(count: int, seed: int) -> Rows:
    """Yield of clean recordings in how many a gap, any cause, or the vehicle's field is told."""
    cases = (make_case(CasePlan("clean", (), ()), seed, number) for number in itertools.count(1))
    wanted = (case for case in cases if case.key["sensors"] == 4 and case.key["with_scalar"])
    outcomes: dict[str, list[Outcome]] = {kind: [] for kind in BESIDE}
    for number, case in track(enumerate(itertools.islice(wanted, count)), "recordings", count):
        kind = list(BESIDE)[number % len(BESIDE)]
        rng = np.random.default_rng([seed, number])
        beside = {name: drawn(rng, case.columns["time_s"]) for name, drawn in BESIDE[kind].items()}
        outcomes[kind].append(answered(f"{number} {kind}", replace(case, columns=case.columns | beside)))
    for kind, some in {"all": [one for each in outcomes.values() for one in each], **outcomes}.items():
        told = Rate.of(one.verdict != NO_GAP for one in some)
        yield kind, "recordings", told.cases
        yield kind, "a gap told", told.hits
        yield kind, "a gap told, part at most", told.interval[1]
        yield kind, "a cause named", sum(bool(one.named) for one in some)
        yield kind, f"{NAME} named", sum(NAME in one.named for one in some)


def answered(name: str, case: Case) -> Outcome:
    """Return what the diagnosis makes of a case's files, told in one line."""
    with TemporaryDirectory() as folder:
        write_case(Path(folder), case)
        recording = read_recording(Path(folder, "data.csv"))
        answer = gap_to_mapping(diagnose(recording, read_array(Path(folder, "spec.yaml"))))
    outcome = Outcome(name, case.key, answer)
    click.echo(outcome.line)
    return outcome


def switched(rng: np.random.Generator, time_s: FloatArray) -> FloatArray:
    """Return the current of a load that is switched between levels, amperes."""
    load = draw_load(rng, float(time_s[-1]))(time_s)
    return np.round(load + rng.normal(0, 0.01, len(time_s)), 4)


def steered(rng: np.random.Generator, time_s: FloatArray) -> FloatArray:
    """Return the angle of a rudder that is moved to either side, radians."""
    course = draw_wander(rng, float(time_s[-1]), int(rng.integers(8, 20)))(time_s)
    return np.round(0.2 * np.tanh(course) + rng.normal(0, 2e-4, len(time_s)), 5)


BESIDE: Mapping[str, Mapping[str, Drawn]] = {
    "no further channel": {},
    "a second current": {"current_2_A": switched},
    "a rudder": {"actuator_rudder": steered},
    "two further currents and two rudders": {
        "current_2_A": switched,
        "current_3_A": switched,
        "actuator_port": steered,
        "actuator_starboard": steered,
    },
}
"""Channels that are recorded beside clean fields, in turn; temperature, `current_A` and attitude as the check draws."""


@click.command(help=__doc__)
@click.argument("kind", type=click.Choice([*KINDS, "clean"]))
@click.option("--cases", default=80, show_default=True)
@click.option("--seed", type=click.IntRange(min=0), required=True)
def main(kind: str, cases: int, seed: int) -> None:
    """Make, answer and count, and keep the counts beside those of the other kinds."""
    rows = list(of_clean(cases, seed) if kind == "clean" else of_cases(KINDS[kind], cases, seed))
    lines = [f'{kind},{seed},"{what}","{figure}",{value:.4g}' for what, figure, value in rows]
    click.echo("\n".join(lines))
    stored = RESULTS.read_text(encoding="utf-8").splitlines()[2:] if RESULTS.exists() else []
    others = [line for line in stored if not line.startswith(f"{kind},")]
    head = ["# python benchmarks/platform_field_named.py KIND --cases CASES --seed SEED", "kind,seed,what,figure,value"]
    with write_whole(RESULTS) as beside:
        beside.write_text("\n".join([*head, *others, *lines]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
