"""YAML text for people and programs: read as a mapping of plain values, laid out for reading when written.

What is read may be hostile. Values are those of YAML 1.2's core schema, so that ``on`` and ``1:30`` are text; sizes are
counted while the parser gives its events, before anything is made of them.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from tam_calibration.files.text_files import in_file, read_text
from tam_calibration.model.exceptions import InputError, quoted

MOST_CHARACTERS = 1 << 24
"""Of a text: the calibration of 64 sensors, whose covariance has 768² numbers, takes 15 million."""

MOST_NODES = 1_000_000
"""Keys, values, lists and mappings of a text, with all that aliases stand for: 64 sensors make 0.6 million."""

MOST_LEVELS = 64
"""Lists and mappings within each other: our files have seven, and Python's calls of itself end at a thousand."""

LONGEST_KEY = 100
"""Characters: sentences name keys, and those of our files have half as many."""

_TEXT_TAGS = ("!", "tag:yaml.org,2002:str")
"""What may stand before a scalar: that it is text, whatever it looks like."""

_PLAIN: tuple[tuple[re.Pattern[str], Callable[[str], Any]], ...] = (
    (re.compile(r"(~|null|Null|NULL)?"), lambda text: None),
    (re.compile(r"true|True|TRUE"), lambda text: True),
    (re.compile(r"false|False|FALSE"), lambda text: False),
    (re.compile(r"[-+]?[0-9]{1,300}"), int),
    (re.compile(r"0o[0-7]{1,300}"), lambda text: int(text[2:], 8)),
    (re.compile(r"0x[0-9a-fA-F]{1,300}"), lambda text: int(text, 16)),
    (re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"), float),
    (re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"), lambda text: float(text.replace(".", ""))),
)
"""Plain scalars that are no text (YAML 1.2.2, 10.3.2) and their values; longer whole numbers are beyond any float."""

_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def parse_mapping(text: str) -> dict[str, Any]:
    """Return the mapping that a text contains.

    Its keys are short lines of text. Values are None, truths, numbers, text, lists and mappings; a date is text. An
    alias is replaced by its value.

    Parameters
    ----------
    text : str
        Of a file, a topic or a parameter; it may hold anything.

    Raises
    ------
    InputError
        When it is not YAML, no mapping, too large or too deep, or names types.
    """
    if len(text) > MOST_CHARACTERS:
        raise InputError(f"it has {len(text)} characters, more than {MOST_CHARACTERS}: this is not one of our files")
    try:
        content = _Reader(text).document()
    except yaml.MarkedYAMLError as problem:
        line = f" at line {problem.problem_mark.line + 1}" if problem.problem_mark else ""
        raise InputError(f"this is not YAML{line}: {problem.problem}") from None
    except (yaml.YAMLError, UnicodeError) as problem:
        raise InputError(f"this is not YAML: {' '.join(str(problem).split())}") from None
    if not isinstance(content, dict):
        raise InputError("the file must hold keys and values such as 'baseline_m: 0.5'")
    return content


class _Reader:
    """Makes the value of a text, event by event."""

    def __init__(self, text: str) -> None:
        self._events: Iterator[Any] = yaml.parse(text, _Loader)
        self._nodes = 0
        self._anchored: dict[str, Any] = {}

    def document(self) -> Any:
        """Return the value of the only document, None where there is none."""
        next(self._events)
        if isinstance(next(self._events), yaml.StreamEndEvent):
            return None
        value = self._value(next(self._events), 1)
        next(self._events)
        after = next(self._events)
        if not isinstance(after, yaml.StreamEndEvent):
            raise _fault(after, "a second document begins: keep one")
        return value

    def _value(self, event: Any, level: int) -> Any:
        self._count(event, level)
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in self._anchored:
                raise _fault(event, f"nothing before it has the anchor {quoted(event.anchor)}")
            self._count_parts(event, self._anchored[event.anchor], level)
            return self._anchored[event.anchor]
        is_scalar = isinstance(event, yaml.ScalarEvent)
        if event.tag is not None and not (is_scalar and event.tag in _TEXT_TAGS):
            tag = event.tag.replace("tag:yaml.org,2002:", "!!")
            raise _fault(event, f"the tag {quoted(tag)} is not read: leave it out")
        if is_scalar:
            value = _scalar(event)
        elif isinstance(event, yaml.SequenceStartEvent):
            value = [self._value(part, level + 1) for part in self._until(yaml.SequenceEndEvent)]
        else:
            value = self._mapping(level)
        if event.anchor is not None:
            self._anchored[event.anchor] = value
        return value

    def _mapping(self, level: int) -> dict[str, Any]:
        mapping: dict[str, Any] = {}
        for event in self._until(yaml.MappingEndEvent):
            if not isinstance(event, yaml.ScalarEvent):
                raise _fault(event, "a key must be text: no list, mapping or alias")
            if len(event.value) > LONGEST_KEY or not event.value.isprintable():
                raise _fault(event, f"a key must be one line of at most {LONGEST_KEY} characters")
            if event.value in mapping:
                raise _fault(event, f"the key {event.value!r} is there twice")
            self._value(event, level + 1)
            mapping[event.value] = self._value(next(self._events), level + 1)
        return mapping

    def _until(self, end: type) -> Iterator[Any]:
        while not isinstance(event := next(self._events), end):
            yield event

    def _count_parts(self, event: Any, value: Any, level: int) -> None:
        """Count the parts of the value of an alias as if it were written out."""
        parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
        for part in parts:
            self._count(event, level + 1)
            self._count_parts(event, part, level + 1)

    def _count(self, event: Any, level: int) -> None:
        self._nodes += 1
        if self._nodes > MOST_NODES:
            raise _fault(event, f"there are more than {MOST_NODES} keys and values: this is not one of our files")
        if level > MOST_LEVELS:
            raise _fault(event, f"more than {MOST_LEVELS} lists and mappings lie within each other")


def _scalar(event: Any) -> Any:
    is_plain, _ = event.implicit
    if is_plain and event.tag is None:
        for pattern, value_of in _PLAIN:
            if pattern.fullmatch(event.value):
                return value_of(event.value)
    return event.value


def _fault(event: Any, problem: str) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)


@contextmanager
def mapping_in(path: Path) -> Iterator[dict[str, Any]]:
    """Give the mapping that a file contains; errors, here or in the block, name the file.

    Raises
    ------
    InputError
        When the file cannot be read, is not YAML, or contains no mapping.
    """
    text = read_text(path)
    with in_file(path):
        yield parse_mapping(text)


_SafeDumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


class _Dumper(_SafeDumper):  # type: ignore[misc]
    def ignore_aliases(self, data: Any) -> bool:
        return True


def _represent_list(dumper: yaml.SafeDumper, data: list[Any]) -> yaml.Node:
    is_flat = not any(isinstance(item, list | dict) for item in data)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=is_flat)


def _represent_float(dumper: yaml.SafeDumper, data: float) -> yaml.Node:
    return dumper.represent_none(None) if math.isnan(data) else dumper.represent_float(data)


_Dumper.add_representer(list, _represent_list)
_Dumper.add_representer(float, _represent_float)
_Dumper.add_implicit_resolver(  # text that YAML 1.1 has for text, as 1e5, is to be quoted
    "tag:yaml.org,2002:plain", re.compile(f"({'|'.join(pattern.pattern for pattern, _ in _PLAIN)})$"), None
)


def dump_mapping(content: Mapping[str, Any]) -> str:
    """Return YAML in the order of the keys, flat lists on one line.

    Numbers read back exactly; NaN becomes null, as in JSON.
    """
    return yaml.dump(dict(content), Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120)
