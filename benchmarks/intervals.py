"""How often the 95 % intervals of a cause's parameters hold the true values, beside what is unknown.

Run ``python benchmarks/intervals.py [RECORDING ARRAY …] --seed SEED [--cases 0] [--draws 4] [--diagnosed 1]``.

- Simulated: as many recordings of the check on withheld effects, of single causes and of known ones beside unknown
  ones, one in two, whose cause has a size that can be stated: a delay, a step, the field of an ampere. Each is
  diagnosed, and calibrated with the effect by name.
- Recorded: real recordings, in which a temperature, a current or a step is put at 1 and 3 times what they leave by
  themselves (``tam blind inject``), so many draws of each. Each is calibrated with the effect by name, and the first
  draws are diagnosed as well. The rest of a real recording is unknown, coloured, and follows the motion.

Counted apart are what was put in, and terms of the same effect that the answer states besides: their true value is 0,
and they are stated only where chance or the unknown part makes them large. A step is compared where its times are right
to 2 % of the recording: at another time it is another step.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.spatial.transform import Rotation

from tam_calibration import diagnose
from tam_calibration.gap.calibration_with_effects import calibrate_with_effects
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.fitted_effect import FittedEffect
from tam_calibration.model.recording import Recording
from tam_calibration.recordings import read_array, read_recording
from tam_validation.blind.case import make_case
from tam_validation.blind.case_plan import CasePlan, plan_cases
from tam_validation.blind.folder import write_case
from tam_validation.blind.injected import inject
from tam_validation.blind.rates import WITHIN_95, Rate
from tam_validation.blind.recorded import Recorded

SIZED = ("bias_jump", "current_interference", "time_skew")
"""Simulated effects whose size is one number for each axis, in key and answer alike."""

KINDS = ("single", "mixed")
"""Of simulated cases: a cause alone, and one beside an unknown cause."""

PUT_IN = ("bias_jump", "current_interference", "temperature_drift")
"""The same of those that are put into recordings."""

TIMES = (1.0, 3.0)
"""Sizes of what is put in, over what a recording leaves by itself."""

SAME_TIME = 0.02
"""Part of the recording within which a step is at the right time."""

FAR = 5.0
"""Standard errors beyond which an answer is not merely unlucky: one in two million of normal errors."""

SAMPLES = 2000
"""Samples of a recording that are taken at most, evenly: with more, an answer takes longer and is no other."""

MANY = 100
"""Plans that are drawn for each case that is wanted: few have a cause with a size."""


@dataclass(frozen=True)
class Told:
    """A parameter of an answer: its deviation in standard errors, and whether it is one of those that were put in."""

    pull: float
    is_put_in: bool


@click.command()
@click.argument("paths", nargs=-1, type=click.Path(path_type=Path, exists=True))
@click.option("--seed", type=click.IntRange(min=0), required=True)
@click.option("--cases", default=0, show_default=True, help="Simulated recordings.")
@click.option("--draws", default=4, show_default=True, help="Of each effect and size, in each recording.")
@click.option("--diagnosed", default=1, show_default=True, help="Of these draws.")
def main(paths: tuple[Path, ...], seed: int, cases: int, draws: int, diagnosed: int) -> None:
    """Count, and print a table."""
    console, told = Console(width=120), defaultdict[str, list[Told]](list)
    for plan, number in track(simulated_plans(seed, cases), console=console):
        case = simulated(plan, seed, number)
        for words, answer in (("diagnosed", of_diagnosis), ("calibrated", calibrated)):
            # What else the check's own physics adds its key does not say.
            told[f"simulated, {plan.kind}, {words}"] += [one for one in answer(*case) if one.is_put_in]
    for path, array_path in zip(paths[::2], paths[1::2], strict=True):
        recording, array = thinned(read_recording(path)), read_array(array_path)
        for effect in PUT_IN:
            for times in TIMES:
                for draw in range(draws):
                    made = put_into(recording, array, effect, times, seed + draw)
                    if made is None:
                        continue
                    told[f"recorded, {effect}, calibrated"] += calibrated(*made, array)
                    if draw < diagnosed:
                        told[f"recorded, {effect}, diagnosed"] += of_diagnosis(*made, array)
    console.print(table_of(told))


def thinned(recording: Recording) -> Recording:
    """Return a recording with a bounded number of samples."""
    return recording.take(slice(None, None, -(-recording.sample_count // SAMPLES)))


def simulated_plans(seed: int, cases: int) -> list[tuple[CasePlan, int]]:
    """Return plans of cases whose known cause has a size, with their numbers in the set."""
    numbered = enumerate(plan for kind in KINDS for plan in _sized(kind, seed, cases // len(KINDS)))
    return [(plan, number) for number, plan in numbered]


def _sized(kind: str, seed: int, cases: int) -> list[CasePlan]:
    plans = plan_cases((kind,), MANY * cases, seed) if cases else []
    return [plan for plan in plans if plan.effects[0] in SIZED][:cases]


def simulated(plan: CasePlan, seed: int, number: int) -> tuple[Recording, dict[str, Any], Array]:
    """Return a simulated case, with the key of its known cause."""
    case = make_case(plan, seed, number)
    with TemporaryDirectory() as folder:
        write_case(Path(folder), case)
        recording, array = read_recording(Path(folder, "data.csv")), read_array(Path(folder, "spec.yaml"))
    return recording, case.key["effects"][0], array


def put_into(
    recording: Recording, array: Array, effect: str, times: float, seed: int
) -> tuple[Recording, dict[str, Any]] | None:
    """Return a recording with an effect in it, and the key; None where it cannot be so large."""
    attitude = None if recording.attitude is None else Rotation.from_quat(recording.attitude).as_matrix()
    try:
        recorded = Recorded(recording.time_s, recording.readings_T, recording.scalar_T, attitude, array.positions_m)
        made = inject(recorded, effect, times, seed)
    except Refused:
        return None
    own = {"temperature_C": None, "current_A": None, **made.columns}
    changed = replace(recording, **own)
    return changed, made.key


def calibrated(recording: Recording, key: dict[str, Any], array: Array) -> list[Told]:
    """Compare what a calibration with the effect tells."""
    try:
        effects = calibrate_with_effects(recording, array, [key["effect"]]).effects
    except (InputError, Refused):
        return []
    return list(compared(effects, recording, key))


def of_diagnosis(recording: Recording, key: dict[str, Any], array: Array) -> list[Told]:
    """Compare what a diagnosis tells."""
    return list(compared((cause.fitted for cause in diagnose(recording, array).causes), recording, key))


def compared(effects: Iterable[FittedEffect], recording: Recording, key: dict[str, Any]) -> Iterator[Told]:
    """Yield the parameters that answer and key state of the same effect at the same sensor."""
    for effect in effects:
        if effect.effect != key["effect"] or not is_at_its_times(effect, recording, key):
            continue
        for one in effect.contributions:
            for name, error in one.standard_errors.items():
                place = f"sensor {one.sensor + 1}" + ("" if one.axis is None else f" {'xyz'[one.axis]}")
                true = key["coefficients"].get(f"{place} {name}")
                unit = 1.0 if name == "delay" else 1e-9
                if error > 0 and key["coefficients"]:
                    yield Told(abs(one.values[name] - (true or 0.0) * unit) / error, true is not None)


def is_at_its_times(effect: FittedEffect, recording: Recording, key: dict[str, Any]) -> bool:
    """Whether a step is where the true one is; any other effect has no times."""
    if effect.effect != "bias_jump":
        return True
    since = np.array(list(effect.shape.values())) - recording.time_s[0]
    true = np.array(key["parameters"]["times_s"])
    return len(since) == len(true) and bool(np.abs(since - true).max() < SAME_TIME * np.ptp(recording.time_s))


def table_of(told: dict[str, list[Told]]) -> Table:
    """Return coverage, with Wilson's intervals, and how many are far off."""
    table = Table("set", "parameters", "n", "covered", "95 % interval", f"beyond {FAR:g} standard errors")
    for name, all_of_them in told.items():
        put_in = [one for one in all_of_them if one.is_put_in]
        for words, these in (("put in", put_in), ("all that is told", all_of_them))[: 1 + (put_in != all_of_them)]:
            rate = Rate.of([one.pull <= WITHIN_95 for one in these])
            low, high = rate.interval
            far = sum(one.pull > FAR for one in these)
            table.add_row(name, words, str(rate.cases), f"{rate.value:.1%}", f"{low:.1%} – {high:.1%}", str(far))
    return table


if __name__ == "__main__":
    main()
