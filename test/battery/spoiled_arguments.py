"""Command lines that a person or a script mistypes."""

from dataclasses import replace
from pathlib import Path

import click
from numpy.random import Generator

from battery.recipes import Recipe
from battery.trial import May, Trial, pick
from tam_calibration.cli.main import main

_NO_NUMBERS = (
    "nan",
    "-nan",
    "inf",
    "-inf",
    "1e400",
    "abc",
    "",
    " ",
    "1,5",
    "0x",
    "--",
    "1e",
    "٣x",
    "None",
    "1;2",
    "\t",
)
_STRANGE = (
    *("-", "--", "", " ", ".", "..", "/", "~", "*", "a\nb", "\x1b[31mred", "%s%n", "{0}", "$(true)", "\udcff\udcfe"),
    *("é" * 130, "x" * 5000, "0", "-1", "1", "1e308", "-1e308", "1e-320", "9" * 400, "1,2", "0,0,0", "nan,0,0"),
    *(
        "1e300,0,0",
        "91,0,2026-01-01",
        "0,0,2026-02-30",
        "0,0,99999-01-01",
        "auto",
        "maximum_likelihood",
        "5",
        "99999999999",
    ),
)


_ENDLESS = ("scheduler", "rate")
"""Options that may make a command wait as long as it is told to."""


def command_of(recipe: Recipe) -> click.Command:
    """Return the command of a recipe, the inner one of a group."""
    command: click.Command = main.get_command(click.Context(main), recipe.command)
    if isinstance(command, click.Group):
        return command.commands[recipe.line[1]]
    return command


def _options(recipe: Recipe) -> list[click.Option]:
    return [each for each in command_of(recipe).params if isinstance(each, click.Option) and each.name != "help"]


def _no_number(recipe: Recipe, rng: Generator) -> Trial | None:
    """Give an option that takes a number something else."""
    kinds = click.types.FloatParamType | click.types.IntParamType
    numeric = [each for each in _options(recipe) if isinstance(each.type, kinds) and each.name not in _ENDLESS]
    if not numeric:
        return None
    option, token = pick(rng, numeric).opts[0], pick(rng, _NO_NUMBERS)
    return replace(Trial.of(recipe, f"{option} {token!r}", May.REFUSE), line=(*recipe.line, option, token))


def _any_value(recipe: Recipe, rng: Generator) -> Trial | None:
    """Give an option or an argument anything."""
    options = [each for each in _options(recipe) if not each.is_flag and each.name not in _ENDLESS]
    token = pick(rng, _STRANGE)
    if options and rng.random() < 0.7:
        option = pick(rng, options).opts[0]
        line = (*recipe.line, option, token)
        return replace(Trial.of(recipe, f"{option} {token[:40]!r}", May.DO_ANYTHING), line=line)
    place = int(rng.integers(1, len(recipe.line))) if len(recipe.line) > 1 else 0
    line = (*recipe.line[:place], token, *recipe.line[place + 1 :])
    return replace(Trial.of(recipe, f"{token[:40]!r} for {recipe.line[place]}", May.DO_ANYTHING), line=line)


def _flag(recipe: Recipe, rng: Generator) -> Trial | None:
    """Ask for what goes with something else."""
    flags = [each for each in _options(recipe) if each.is_flag and each.name != "loop"]
    if not flags:
        return None
    option = pick(rng, flags).opts[0]
    return replace(Trial.of(recipe, option, May.DO_ANYTHING), line=(*recipe.line, option))


def _shuffled(recipe: Recipe, rng: Generator) -> Trial:
    """Lose, repeat or exchange words."""
    words = list(recipe.line)
    for _ in range(int(rng.integers(1, 3))):
        place, other = (int(each) for each in rng.integers(1, max(2, len(words)), size=2))
        way = pick(rng, ("lost", "repeated", "exchanged", "added"))
        if way == "lost" and len(words) > 1:
            del words[min(place, len(words) - 1)]
        elif way == "repeated":
            words.insert(place, words[min(other, len(words) - 1)])
        elif way == "added":
            words.insert(place, pick(rng, ("--none", "-q", "-oo", "--=", "---", "-", "extra", "--help=1")))
        elif max(place, other) < len(words):
            words[place], words[other] = words[other], words[place]
    return replace(Trial.of(recipe, f"tam {' '.join(words)}", May.DO_ANYTHING), line=tuple(words))


_HEAVY = {"demo", "reproduce", "blind make"}
"""Of these only what is refused is tried: what is not takes minutes."""


def spoil(recipe: Recipe, folder: Path, rng: Generator) -> Trial:
    """Spoil the words of a recipe's line."""
    ways = (
        (_no_number,) if recipe.name in _HEAVY else (_no_number, _no_number, _any_value, _any_value, _flag, _shuffled)
    )
    trial = pick(rng, ways)(recipe, rng)
    if trial is None:
        trial = replace(Trial.of(recipe, "an option that there is not", May.REFUSE), line=(*recipe.line, "--none"))
    return trial
