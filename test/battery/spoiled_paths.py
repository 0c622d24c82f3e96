"""Inputs that are no files, and outputs that are inputs or cannot be written."""

import os
import socket
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from numpy.random import Generator

from battery.recipes import Recipe
from battery.trial import May, Trial, pick

_OUTPUT_OPTIONS = ("-o", "--output", "--json", "--report")


def _link(folder: Path, path: Path, target: str) -> str:
    path.symlink_to(target)
    return path.name


def _socket(path: Path) -> str:
    with socket.socket(socket.AF_UNIX) as end:
        end.bind(os.path.relpath(path))
    return path.name


def _odd_file(folder: Path, rng: Generator, good: str) -> tuple[str, str, May]:
    """Make something that is no plain file; return its name, what it is, and what may become of it."""
    suffix = Path(good).suffix
    path = folder / f"odd{suffix}"
    kinds: dict[str, tuple[Callable[[], str], May]] = {
        "a pipe": (lambda: os.mkfifo(path) or path.name, May.REFUSE),
        "a socket": (lambda: _socket(path), May.REFUSE),
        "a folder": (lambda: path.mkdir() or path.name, May.REFUSE),
        "a loop of links": (lambda: _link(folder, path, path.name), May.REFUSE),
        "a link to nothing": (lambda: _link(folder, path, "nowhere"), May.REFUSE),
        "a link to zeros": (lambda: _link(folder, path, "/dev/zero"), May.REFUSE),
        "a link to itself by /proc": (lambda: _link(folder, path, "/proc/self/mem"), May.REFUSE),
        "a link to a pipe": (lambda: os.mkfifo(folder / "pipe") or _link(folder, path, "pipe"), May.REFUSE),
        "a link to the good one": (lambda: _link(folder, path, good), May.DO_THE_SAME),
        "zeros": (lambda: "/dev/zero", May.REFUSE),
        "random bytes": (lambda: "/dev/urandom", May.REFUSE),
        "nothing": (lambda: "/dev/null", May.REFUSE),
        "the keyboard": (lambda: "/dev/stdin", May.REFUSE),
        "a folder of the system": (lambda: "/proc", May.REFUSE),
        "a file of the system": (lambda: "/proc/self/environ", May.REFUSE),
        "no name": (lambda: "", May.REFUSE),
        "a long name": (lambda: "x" * int(rng.integers(256, 9000)) + suffix, May.REFUSE),
        "a name of many lines": (lambda: "a\nb\x1b[2J" + suffix, May.REFUSE),
        "a name that is no UTF-8": (lambda: "\udcff\udc80" + suffix, May.REFUSE),
        "a file below a file": (lambda: f"{good}/{path.name}", May.REFUSE),
    }
    kind = pick(rng, sorted(kinds))
    make, may = kinds[kind]
    return make(), kind, may


def _renamed(folder: Path, rng: Generator, good: str) -> tuple[str, str, May]:
    """Give a good input another name or another ending."""
    name = pick(rng, ("a b", "é", "=1+1", "\udcff", "a\nb", "-x", "@SUM", "%", "a#b", "?", "new")) + pick(
        rng, (Path(good).suffix, "", ".csv", ".mcap", ".db3", ".yaml", ".CSV")
    )
    os.rename(folder / good, folder / name)
    return f"./{name}", f"called {name!r}", May.DO_ANYTHING


def spoil_input(recipe: Recipe, folder: Path, rng: Generator) -> Trial:
    """Put something that is no file for an input, or a file of another kind."""
    good = pick(rng, recipe.reads)
    if rng.random() < 0.2:
        name, told, may = _renamed(folder, rng, good)
    elif rng.random() < 0.2:
        others = sorted(each.name for each in folder.iterdir() if each.name != good)
        name, told, may = pick(rng, others), "another file", May.DO_ANYTHING
    else:
        name, told, may = _odd_file(folder, rng, good)
    return Trial.of(recipe, f"{told} for {good}", may).instead(good, name)


def _option_of(recipe: Recipe, rng: Generator) -> str:
    return pick(rng, [word for word in recipe.line if word in _OUTPUT_OPTIONS])


def _with_output(recipe: Recipe, option: str, name: str, told: str, may: May) -> Trial:
    place = recipe.line.index(option) + 1
    return replace(
        Trial.of(recipe, f"{option} {told}", may), line=(*recipe.line[:place], name, *recipe.line[place + 1 :])
    )


def spoil_output(recipe: Recipe, folder: Path, rng: Generator) -> Trial:
    """Name an input as an output, or something that cannot be written."""
    if rng.random() < 0.1:
        return _called_otherwise(recipe, rng)
    option = _option_of(recipe, rng)
    if recipe.reads and rng.random() < 0.6:
        name, told = _path_of_input(recipe, folder, rng)
        return _with_output(recipe, option, name, told, May.REFUSE)
    name, told, may = _odd_output(folder, rng)
    return _with_output(recipe, option, name, told, may)


def _called_otherwise(recipe: Recipe, rng: Generator) -> Trial:
    """Give the outputs names that mean something to a shell, in a URI, in a pattern or in Python, and are allowed."""
    name = pick(rng, ("a b", "é", "=1+1", "a#b", "a?b=1", "5%41", "{0}", "%s", "a'b", "[a]*", "~", "$HOME", "a;b", "…"))
    renamed = {word: word.replace("new", name) for word in (*recipe.line, *recipe.writes) if word.startswith("new")}
    line, writes = (tuple(renamed.get(word, word) for word in words) for words in (recipe.line, recipe.writes))
    return Trial.of(replace(recipe, line=line, writes=writes), f"outputs called {name!r}", May.DO_THE_SAME)


def _path_of_input(recipe: Recipe, folder: Path, rng: Generator) -> tuple[str, str]:
    """Return a name by which an input, or a place within it, would be overwritten."""
    good = pick(rng, recipe.reads)
    path = folder / good
    inner = good
    if path.is_dir():
        names = [str(each.relative_to(folder)) for each in path.iterdir()]
        inner = pick(rng, [*names, f"{good}/new.csv", f"{good}/new.yaml", f"{good}/x.db3", f"{good}/deep/new.json"])
    way = pick(
        rng, ("itself", "the long way", "whole path", "by a link", "by a link of the folder", "by /proc", "hard link")
    )
    if way == "the long way":
        return f"missions/.././{inner}", f"{inner}, {way}"
    if way == "whole path":
        return str(folder / inner), f"{inner}, {way}"
    if way == "by a link":
        return _link(folder, folder / "linked", inner), f"{inner}, {way}"
    if way == "by a link of the folder":
        return f"{_link(folder, folder / 'here', '.')}/{inner}", f"{inner}, {way}"
    if way == "by /proc":
        return f"/proc/self/cwd/{inner}", f"{inner}, {way}"
    if way == "hard link" and (folder / inner).is_file():
        os.link(folder / inner, folder / "linked")
        return "linked", f"{inner}, {way}"
    return inner, inner


def _odd_output(folder: Path, rng: Generator) -> tuple[str, str, May]:
    """Return an output that cannot be written, or not in the usual way."""
    names = {
        "a device": ("/dev/null", May.DO_ANYTHING),
        "a full device": ("/dev/full", May.REFUSE),
        "a folder that is not there": ("none/new.csv", May.REFUSE),
        "a folder that is there": ("missions", May.REFUSE),
        "below a file": ("array.yaml/new", May.REFUSE),
        "the root": ("/", May.REFUSE),
        "here": (".", May.DO_ANYTHING),
        "above": ("..", May.REFUSE),
        "no name": ("", May.DO_ANYTHING),
        "a long name": ("x" * int(rng.integers(230, 300)) + ".csv", May.DO_ANYTHING),
        "of lines": ("a\nb.csv", May.DO_ANYTHING),
        "of bytes": ("\udcff.csv", May.DO_ANYTHING),
        "a folder's": ("new/", May.DO_ANYTHING),
        "of the system": ("/proc/new.csv", May.REFUSE),
        "a set that is taken": (_taken(folder), May.DO_ANYTHING),
        "a pipe": (os.mkfifo(folder / "pipe") or "pipe", May.REFUSE),
        "a loop": (_link(folder, folder / "loop", "loop"), May.DO_ANYTHING),
    }
    told = pick(rng, sorted(names))
    return names[told][0], told, names[told][1]


def _taken(folder: Path) -> str:
    """Make folders at the names of what goes with an output, and return that."""
    for ending in ("truth.yaml", "array.yaml", "key.json"):
        (folder / f"set.{ending}").mkdir()
    return "set.csv"
