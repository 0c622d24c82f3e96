"""Whether sound recordings of another physics pass the check of the channels, and what is spoiled in them is named.

Run ``tam blind make CASES --cases 108 --seed 1``, then ``python benchmarks/integrity.py CASES --seed 1``. CASES may be
made by any other simulator too: of each recording ``CASE/data.csv`` and ``CASE/spec.yaml``, and a ``key.json`` that
tells its effect. Every recording is
checked as it is, and once more with a fault of each kind that is drawn at random. Refused unspoiled is wrong, unless
the effect of the recording is one that shows as that fault; spoiled it must be refused by the name of its fault, or of
one that the same spoiling also makes. Ten milligauss are a microtesla: such an axis is named after the fit, by the
limit on scale factors.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from asked import Figure, show
from numpy.random import Generator

from tam_calibration.correction.acceptance import LIMITS
from tam_calibration.effects.library import installed_effects, shown_by
from tam_calibration.fit import calibrate
from tam_calibration.integrity.check import faults_of
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray, from_nanotesla
from tam_calibration.recordings import read_array, read_recording
from tam_validation.blind.folder import KEYS, read_json

ASKED_NAMED = 0.99
"""Part of the spoiled recordings that are refused by the right name."""


def another_unit(readings_T: FloatArray, rng: Generator) -> None:
    """Have an axis in another unit."""
    readings_T[:, _sensor(rng), _axis(rng)] *= rng.choice([1e-9, 1e-3, 1e-5, 0.1, 10.0, 1e3])


def saturated(readings_T: FloatArray, rng: Generator) -> None:
    """End the range of an axis within what it reads."""
    axis = readings_T[:, _sensor(rng), _axis(rng)]
    limit_T = rng.uniform(0.3, 0.8) * np.abs(axis).max()
    np.clip(axis, -limit_T, limit_T, out=axis)


def repeated(readings_T: FloatArray, rng: Generator) -> None:
    """Have a sensor repeat another, up to twenty samples later."""
    one, other = rng.choice(readings_T.shape[1], size=2, replace=False)
    readings_T[:, other] = np.roll(readings_T[:, one], rng.integers(0, 20), axis=0)


def frozen(readings_T: FloatArray, rng: Generator) -> None:
    """Have a sensor stand still for a quarter to a half of the recording."""
    count = len(readings_T)
    begin, length = int(rng.integers(count // 2)), int(rng.uniform(0.25, 0.5) * count)
    sensor = _sensor(rng)
    readings_T[begin : begin + length, sensor] = readings_T[begin, sensor]


def zero(readings_T: FloatArray, rng: Generator) -> None:
    """Have a sensor read nothing for a while."""
    begin = int(rng.integers(len(readings_T) // 2))
    readings_T[begin : begin + len(readings_T) // 4, _sensor(rng)] = 0.0


def bit_set(readings_T: FloatArray, rng: Generator) -> None:
    """Have a bit of a converter with steps of 1 nT always set."""
    axis = readings_T[:, _sensor(rng), _axis(rng)]
    step_T = from_nanotesla(1.0)
    axis[:] = step_T * (np.round(axis / step_T).astype(int) | (1 << int(rng.integers(9, 15))))


def bit_clear(readings_T: FloatArray, rng: Generator) -> None:
    """Have a bit of a converter with steps of 3.7 nT always clear."""
    axis = readings_T[:, _sensor(rng), _axis(rng)]
    step_T = from_nanotesla(3.7)
    axis[:] = step_T * (np.round(axis / step_T).astype(int) & ~(1 << int(rng.integers(7, 13))))


def bits_joined(readings_T: FloatArray, rng: Generator) -> None:
    """Have two neighbouring bits of a converter always set, as where their lines touch a supply."""
    axis = readings_T[:, _sensor(rng), _axis(rng)]
    step_T = from_nanotesla(1.0)
    axis[:] = step_T * (np.round(axis / step_T).astype(int) | (3 << int(rng.integers(8, 13))))


def coarse(readings_T: FloatArray, rng: Generator) -> None:
    """Read in steps that are hundreds of times the noise."""
    step_T = from_nanotesla(rng.uniform(300, 5000))
    readings_T[:] = step_T * np.round(readings_T / step_T)


def mirrored(readings_T: FloatArray, rng: Generator) -> None:
    """Have an axis with the wrong sign."""
    readings_T[:, _sensor(rng), _axis(rng)] *= -1


def exchanged(readings_T: FloatArray, rng: Generator) -> None:
    """Have two axes of a sensor in each other's place."""
    sensor, (one, other) = _sensor(rng), rng.choice(3, size=2, replace=False)
    readings_T[:, sensor, [one, other]] = readings_T[:, sensor, [other, one]]


FAULTS: dict[Callable[[FloatArray, Generator], None], set[str]] = {
    another_unit: {"unit", "scale_factor"},
    saturated: {"saturated"},
    repeated: {"repeated"},
    frozen: {"frozen"},
    zero: {"zero"},
    bit_set: {"stuck_bits"},
    bit_clear: {"stuck_bits"},
    bits_joined: {"stuck_bits"},
    coarse: {"quantised", "frozen", "repeated"},
    mirrored: {"mirrored"},
    exchanged: {"mirrored"},
}
"""What spoils a recording, and by which names that is rightly told."""


def _sensor(rng: Generator) -> int:
    return int(rng.integers(4))


def _axis(rng: Generator) -> int:
    return int(rng.integers(3))


@click.command(help=__doc__)
@click.argument("cases", type=click.Path(exists=True, path_type=Path))
@click.option("--seed", type=int, required=True, help="Of the faults.")
def main(cases: Path, seed: int) -> None:
    """Run the benchmark."""
    rng, wrong, named, counts = np.random.default_rng(seed), 0, Counter[str](), 0
    for name, effects, recording, array in recordings(cases):
        counts += 1
        unexpected = names(recording, array) - shown_by([each for each in effects if each in installed_effects()])
        wrong += bool(unexpected)
        if unexpected:
            print(f"{name} ({', '.join(effects)}) is refused: {unexpected}")
        for spoil, right in FAULTS.items():
            readings_T = recording.readings_T.copy()
            spoil(readings_T, rng)
            found = names(replace(recording, readings_T=readings_T), array)
            named[spoil.__name__] += bool(found & right)
            if not found & right:
                print(f"{name} ({', '.join(effects)}) spoiled by {spoil.__name__}: {found or 'not refused'}")
    figures = [Figure("as they are", f"{counts} recordings", "wrongly refused", wrong, asked=(0.0, 0.0))]
    for spoil in FAULTS:
        part = named[spoil.__name__] / counts
        figures.append(Figure(spoil.__name__, f"{counts} recordings", "named", part, asked=(ASKED_NAMED, 1.0)))
    show(figures, "channels that no sound sensor makes", "of")


def recordings(cases: Path) -> Iterator[tuple[str, list[str], Recording, Array]]:
    """Yield name, effects, recording and array of each case."""
    sealed, plain = cases / KEYS, cases / "key.json"
    for name, told in sorted(read_json(sealed if sealed.exists() else plain).items()):
        folder = cases / name
        yield name, _effects(told), read_recording(folder / "data.csv"), read_array(folder / "spec.yaml")


def _effects(told: dict[str, Any]) -> list[str]:
    """Return the effects of a case by its key, of ours or of a plain one."""
    if "effects" in told:
        return [each["effect"] for each in told["effects"]] or ["none"]
    effect = told["effect"]
    return effect if isinstance(effect, list) else [effect or "none"]


def names(recording: Recording, array: Array) -> set[str]:
    """Return the names by which a recording is refused: by its channels, or else by the limits on what is fitted."""
    found = {fault.name for fault in faults_of(recording, array) if fault.severity == "refusal"}
    if found:
        return found
    try:
        return set(calibrate(recording, array, accept=LIMITS).accepted)
    except (InputError, Refused):
        return set()


if __name__ == "__main__":
    main()
