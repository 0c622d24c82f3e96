"""The cases by their numbers: which command is spoiled in which way."""

import math
import os
import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.random import Generator

from battery import (
    bombs,
    kills,
    nonsense,
    spoiled_arguments,
    spoiled_csv,
    spoiled_paths,
    spoiled_surroundings,
    spoiled_yaml,
)
from battery.damaged_bytes import any_damage
from battery.recipes import BAGS, FOREIGN, OTHERWISE, RECIPES, Recipe
from battery.trial import May, Trial, files_of, pick

Spoil = Callable[[Recipe, Path, Generator], Trial]


def spoil_bytes(recipe: Recipe, folder: Path, rng: Generator) -> Trial:
    """Damage the bytes of an input: mostly of bags, which have checksums."""
    bags = [name for name in recipe.reads if name in BAGS]
    name = pick(rng, bags if bags and rng.random() < 0.8 else recipe.reads)
    path = pick(rng, files_of(folder, name))
    damage = any_damage(rng)
    path.write_bytes(damage(path.read_bytes(), rng))
    may = May.DO_THE_SAME if name in BAGS else May.DO_ANYTHING
    return Trial.of(recipe, f"{path.relative_to(folder)}: {damage.__name__}", may)


@dataclass(frozen=True)
class Family:
    """Cases that are made alike.

    Parameters
    ----------
    spoil : callable
        Spoils the inputs, words or surroundings of a recipe.
    counts : mapping of str to int
        Cases of each recipe.
    """

    spoil: Spoil
    counts: dict[str, int] = field(default_factory=dict)


def _each(count: int, *names: str) -> dict[str, int]:
    return {name: count for name in names if name in RECIPES}


def _kills() -> dict[str, int]:
    """Return a hundred kills of every command that writes, the slowest last."""
    names = (*_WRITING, "diagnose", "batch", *_SLOW)
    of_command = Counter(RECIPES[name].command for name in names)
    return {name: math.ceil(100 / of_command[RECIPES[name].command]) for name in names}


_CALIBRATE = ("calibrate run.csv", *(f"calibrate {bag}" for bag in BAGS))
_CORRECT = ("correct run.csv new.csv", *(f"correct {bag} new.csv" for bag in BAGS))
_OTHERWISE = tuple(recipe.name for recipe in OTHERWISE if recipe.reads[0].endswith(".csv"))
_SLOW = ("reproduce", "blind make", "demo")
"""Which run for many seconds: only what they refuse, or how they are killed, is tried."""
_WITH_ROS = ("nodes", "nodes with parameters", "play", "play sqlite3", "call")
_QUICK = tuple(name for name in RECIPES if name not in _SLOW + _WITH_ROS + ("diagnose", "diagnose a bag", "batch"))
_WRITING = tuple(name for name in _QUICK if RECIPES[name].writes)

FAMILIES = {
    "bytes": Family(
        spoil_bytes,
        _each(30, *_CALIBRATE[1:])
        | _each(25, *(f"inspect {each}" for each in FOREIGN), *(f"calibrate {each}" for each in FOREIGN[:-1]))
        | _each(25, *_CORRECT[1:])
        | _each(12, "correct run_sqlite3 new", "correct run.mcap new.mcap", "recover", "calibrate with delays")
        | _each(6, "simulate", "diagnose a bag", "locate", "play", "play sqlite3", "blind score")
        | _each(4, "simulate a twin", "plan after a recording", "blind inject", "diagnose", "nodes"),
    ),
    "csv": Family(
        spoiled_csv.spoil,
        _each(60, _CALIBRATE[0], _CORRECT[0])
        | _each(12, "locate", "plan after a recording", "simulate a twin", "blind inject")
        | _each(12, *_OTHERWISE, "locate at once", "locate a coil")
        | _each(8, "diagnose"),
    ),
    "yaml": Family(
        spoiled_yaml.spoil,
        _each(60, "simulate", _CALIBRATE[0], _CORRECT[0])
        | _each(20, "plan", "locate", "simulate a twin", "correct run_sqlite3 new.csv", "calibrate run_mcap")
        | _each(20, "calibrate with a source", "export")
        | _each(6, "diagnose", "blind inject", "batch", "nodes", "nodes with parameters"),
    ),
    "arguments": Family(
        spoiled_arguments.spoil, _each(14, *_QUICK) | _each(8, *_SLOW, *_WITH_ROS, "diagnose", "batch")
    ),
    "inputs": Family(
        spoiled_paths.spoil_input,
        _each(8, *(name for name in _QUICK if RECIPES[name].reads)) | _each(6, "diagnose", "batch", "play", "nodes"),
    ),
    "outputs": Family(spoiled_paths.spoil_output, _each(10, *(name for name in _WRITING if name != "blind score"))),
    "surroundings": Family(
        spoiled_surroundings.spoil_environment, _each(6, *_QUICK) | _each(4, "diagnose", "batch", "call", "play")
    ),
    "pipes": Family(spoiled_surroundings.close_pipe, _each(3, *_QUICK)),
    "disks": Family(spoiled_surroundings.fill_disk, _each(8, *_WRITING) | _each(4, "diagnose", "batch")),
    "nonsense": Family(
        nonsense.spoil_meaning,
        _each(60, _CALIBRATE[0])
        | _each(20, _CORRECT[0])
        | _each(10, *_OTHERWISE)
        | _each(6, "locate", "plan", "plan after a recording", "simulate a twin", "diagnose"),
    ),
    "bombs": Family(
        bombs.spoil,
        _each(10, "calibrate run.mcap", "calibrate run_zstd", "calibrate run_sqlite3", "calibrate run.csv", "simulate")
        | _each(
            4, *(name for name in _CORRECT if "run_mcap" not in name), "plan", "plan after a recording", "diagnose"
        ),
    ),
    "kills": Family(kills.end_at_any_moment, _kills()),
}

CASES = [
    (family, recipe)
    for family, content in FAMILIES.items()
    for recipe, count in content.counts.items()
    for _ in range(count)
]
"""Family and recipe of each case, by its number."""


def prepare(number: int, seed: int, material: Path, folder: Path) -> Trial:
    """Copy the good inputs into a folder, spoil what the case spoils, and return what is to be tried.

    Parameters
    ----------
    number : int
        Of the case, an index of ``CASES``.
    seed : int
        Of all cases of a battery.
    material : Path
        The good inputs.
    folder : Path
        That of the case; it is not there yet.
    """
    family, name = CASES[number]
    shutil.copytree(material, folder)
    here = os.getcwd()
    os.chdir(folder)  # names of sockets are short
    try:
        return FAMILIES[family].spoil(RECIPES[name], folder, np.random.default_rng([seed, number]))
    finally:
        os.chdir(here)
