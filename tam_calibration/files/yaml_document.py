"""YAML text for people and programs: read as a mapping of plain values, laid out for reading when written."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from tam_calibration.files.text_files import in_file, read_text
from tam_calibration.model.exceptions import InputError


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """The loader of plain values that does not let the second of two equal keys pass for the first."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> Any:
        seen: set[str] = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if key.value in seen:
                raise yaml.MarkedYAMLError(problem=f"the key {key.value!r} is there twice", problem_mark=key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def parse_mapping(text: str) -> dict[str, Any]:
    """Return the mapping that a text holds.

    Raises
    ------
    InputError
        When it is not YAML, or no mapping.
    """
    try:
        content = yaml.load(text, _Loader)
    except yaml.MarkedYAMLError as problem:
        line = f" at line {problem.problem_mark.line + 1}" if problem.problem_mark else ""
        raise InputError(f"this is not YAML{line}: {problem.problem}") from None
    except (yaml.YAMLError, ValueError) as problem:
        raise InputError(f"this is not YAML: {' '.join(str(problem).split())}") from None
    if not isinstance(content, dict):
        raise InputError("the file must hold keys and values such as 'baseline_m: 0.5'")
    return {str(key): value for key, value in content.items()}


@contextmanager
def mapping_in(path: Path) -> Iterator[dict[str, Any]]:
    """Give the mapping that a file holds; what is wrong with it, here or in the block, is told with the file's name.

    Raises
    ------
    InputError
        When the file cannot be read, is not YAML, or holds no mapping.
    """
    text = read_text(path)
    with in_file(path):
        yield parse_mapping(text)


class _Dumper(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True


def _represent_list(dumper: yaml.SafeDumper, data: list[Any]) -> yaml.Node:
    is_flat = not any(isinstance(item, list | dict) for item in data)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=is_flat)


_Dumper.add_representer(list, _represent_list)


def dump_mapping(content: Mapping[str, Any]) -> str:
    """Return YAML in the order of the keys, flat lists on one line; numbers read back exactly."""
    return yaml.dump(dict(content), Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120)
