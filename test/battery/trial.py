"""What is tried: a command line in a folder that was spoiled, and what may become of it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import TypeVar

from numpy.random import Generator

from battery.recipes import Recipe
from battery.surroundings import PLAIN, Surroundings

Item = TypeVar("Item")


class May(Enum):
    """What a command may do, beside refusing in one sentence."""

    REFUSE = "refuse it, nothing else"
    WARN = "go on with a warning"
    DO_THE_SAME = "give the same numbers, or others with a word on the damage"
    DO_ANYTHING = "give an answer"


@dataclass(frozen=True)
class Trial:
    """A command line, and what may become of it.

    Parameters
    ----------
    recipe : Recipe
        That was spoiled.
    line : tuple of str
        The words after ``tam``.
    told : str
        What was spoiled, for people.
    may : May
        What the command may do, beside refusing.
    around : Surroundings
        What it runs in.
    """

    recipe: Recipe
    line: tuple[str, ...]
    told: str
    may: May
    around: Surroundings = PLAIN

    @classmethod
    def of(cls, recipe: Recipe, told: str, may: May, around: Surroundings = PLAIN) -> "Trial":
        """Return the trial of a recipe's own line."""
        return cls(recipe, recipe.line, told, may, around)

    def instead(self, old: str, new: str) -> "Trial":
        """Return the trial with one word for another."""
        return replace(self, line=tuple(new if word == old else word for word in self.line))


def pick(rng: Generator, choices: Sequence[Item]) -> Item:
    """Return one of several."""
    return choices[int(rng.integers(len(choices)))]


def files_of(folder: Path, name: str) -> list[Path]:
    """Return the files of an input, a file or a bag's folder, in the order of their names."""
    path = folder / name
    return sorted(each for each in path.rglob("*") if each.is_file()) if path.is_dir() else [path]
