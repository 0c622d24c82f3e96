"""YAML that a person mistypes, or that somebody means ill with."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from numpy.random import Generator

from battery.recipes import Recipe
from battery.trial import May, Trial, pick

_MARK = "MARKED_BY_THE_BATTERY"
_NO_NUMBERS = (
    *(".nan", ".inf", "-.inf", "1e400", "abc", "''", "[]", "{}", "[1, [2]]", "{a: 1}", "on", "yes", "true", "1:30"),
    *("1_000", "0x1G", "2026-01-01", "2026-01-01T00:00:00Z", "!!bool abc", "!!timestamp abc", "!!int abc"),
    *("!!float abc", "!!binary abc", "!!set [1]", "!!omap {}", "!!null abc", "!<tag:x> 1", "!!python/name:os.system x"),
    *("!!python/object/apply:os.system [true]", "*unknown", "&a [*a]", "<<: 1", "? 1", "- 1", "'1", "%", "@", "`"),
)
_STRANGE = ("null", "~", "0o17", "0b11", "-0", "1e-320", "+.5", "0", "-1", "1", "1e12", "'1'", "!!str 1", "!!float '1'")
_NUMBER_FILES = ("array.yaml", "scenario.yaml")
"""Files of which every number means something; others hold some that are for people."""


def _places(content: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path to every value."""
    if path:
        yield path
    items = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, value in items:
        yield from _places(value, (*path, key))


def _at(content: Any, path: tuple[Any, ...]) -> Any:
    for key in path:
        content = content[key]
    return content


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _value(name: str, content: Any, rng: Generator) -> tuple[str, str, May]:
    """Put something else for a value."""
    path = pick(rng, list(_places(content)))
    old, parent = _at(content, path), _at(content, path[:-1])
    parent[path[-1]] = _MARK
    is_strange = rng.random() < 0.25
    token = pick(rng, _STRANGE) if is_strange else pick(rng, (*_NO_NUMBERS, *_long(rng)))
    text = yaml.safe_dump(content, sort_keys=False, width=1000).replace(_MARK, token)
    must = not is_strange and _is_number(old) and name in _NUMBER_FILES
    return text, f"{token[:40]} at {path}", May.REFUSE if must else May.DO_ANYTHING


def _long(rng: Generator) -> tuple[str, ...]:
    """Return values that cost more to read than to write."""
    count = int(10 ** rng.uniform(2, 5))
    return (
        ":".join(["1"] * min(count, 3000)) + ".5",
        "9" * count,
        "[" * count,
        "{a: " * count,
        "[" * count + "]" * count,
        "[" + "1, " * count + "1]",
        "'" + "x" * count + "'",
        "- " * count + "1",
    )


def _key(name: str, content: Any, rng: Generator) -> tuple[str, str, May]:
    """Lose, rename or repeat a key."""
    path = pick(rng, [path for path in _places(content) if isinstance(path[-1], str)])
    parent = _at(content, path[:-1])
    way = pick(rng, ("lost", "renamed", "repeated"))
    value = parent.pop(path[-1])
    told = f"{way}: {path}"
    if way == "lost":
        return yaml.safe_dump(content, sort_keys=False), told, May.DO_ANYTHING
    if way == "renamed":
        parent[f"{path[-1]}x"] = value
        return yaml.safe_dump(content, sort_keys=False), told, May.DO_ANYTHING
    parent[path[-1]], parent[_MARK] = value, value
    text = yaml.safe_dump(content, sort_keys=False).replace(_MARK, str(path[-1]))
    return text, told, May.REFUSE if name in _NUMBER_FILES else May.DO_ANYTHING


def _whole(name: str, content: Any, rng: Generator) -> tuple[str, str, May]:
    """Put another document for all of it."""
    count, text = int(10 ** rng.uniform(3, 6)), yaml.safe_dump(content, sort_keys=False)
    laughs = "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, int(rng.integers(3, 12))))
    ways = {
        "opened lists": "[" * count,
        "opened mappings": "{" * count,
        "nested mappings": "".join(" " * n + "a:\n" for n in range(min(count, 3000))),
        "nested lists": "- " * count,
        "opened tags": "!" * count,
        "quoted lines": "'" + "\n" * count,
        "aliases": "a0: &a0 [x, x]\n" + laughs + text,
        "a list": f"[{count}]",
        "a number": str(count),
        "only a comment": "# " + "x" * count,
        "tabs": text.replace(" ", "\t"),
        "another version": "%YAML 9.9\n---\n" + text,
        "two documents": f"{text}---\n{text}",
        "no text": "\x00\x01\x02",
        "a merge": f"<<: &a {{<<: *a}}\n{text}",
        "keys that are lists": f"? [1, 2]\n: 3\n{text}",
    }
    way = pick(rng, sorted(ways))
    may = May.DO_ANYTHING if way in ("tabs", "keys that are lists", "two documents") else May.REFUSE
    return ways[way], way, may if name != "parameters.yaml" else May.DO_ANYTHING


def spoil(recipe: Recipe, folder: Path, rng: Generator) -> Trial:
    """Spoil a YAML file that a recipe reads, or that belongs to a bag."""
    files = [path for name in recipe.reads for path in _yaml_files(folder / name)]
    path = pick(rng, files)
    way = pick(rng, (_value, _value, _value, _key, _whole))
    text, told, may = way(path.name, yaml.safe_load(path.read_text()), rng)
    path.write_text(text)
    if path.name == "metadata.yaml":
        may = May.DO_THE_SAME  # the data beside it are whole
    return Trial.of(recipe, f"{path.name}: {told}", may)


def _yaml_files(path: Path) -> list[Path]:
    return sorted(path.rglob("*.yaml")) if path.is_dir() else [path] if path.suffix == ".yaml" else []
