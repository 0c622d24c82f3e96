"""YAML is read as YAML 1.2's core types, whatever it holds, within bounds of size, depth and aliases."""

import subprocess
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tam_calibration.files import yaml_document
from tam_calibration.files.yaml_document import (
    LONGEST_KEY,
    MOST_CHARACTERS,
    MOST_LEVELS,
    MOST_NODES,
    dump_mapping,
    parse_mapping,
)
from tam_calibration.model.exceptions import InputError

_SCALARS = [
    ("on", "on"),
    ("yes", "yes"),
    ("y", "y"),
    ("OFF", "OFF"),
    ("1:30", "1:30"),
    ("1" + ":1" * 500, "1" + ":1" * 500),
    ("1_000", "1_000"),
    ("0b1", "0b1"),
    ("2016-01-15", "2016-01-15"),
    ("2016-01-15T00:00:30Z", "2016-01-15T00:00:30Z"),
    ("'1e-9'", "1e-9"),
    ("! 12", "12"),
    ("!!str 12", "12"),
    ("1e-9", 1e-9),
    ("-.5", -0.5),
    ("5.", 5.0),
    ("1.5E+3", 1500.0),
    ("-.inf", float("-inf")),
    ("+12", 12),
    ("012", 12),
    ("0o17", 15),
    ("0x1F", 31),
    ("9" * 5000, float("inf")),
    ("true", True),
    ("FALSE", False),
    ("null", None),
    ("~", None),
    ("", None),
]


@pytest.mark.parametrize(("text", "value"), _SCALARS, ids=[text[:30] for text, _ in _SCALARS])
def test_plain_scalars_are_those_of_yaml_1_2(text, value):
    """No word but true and false is a truth, and nothing with colons, underscores or in quotes is a number."""
    read = parse_mapping(f"a: {text}\n")["a"]
    assert read == value and type(read) is type(value)


def test_keys_are_text_and_merge_nothing():
    """What looks like a number, a truth or a merge stays the key that was written."""
    assert parse_mapping("1: a\non: b\n~: c\n<<: {d: e}\n") == {"1": "a", "on": "b", "~": "c", "<<": {"d": "e"}}


def test_an_alias_is_what_it_stands_for():
    """Of keys and values."""
    text = "a: &row [1, 2]\n&name b: *row\nc: *name\nd: {e: *row}\n"
    assert parse_mapping(text) == {"a": [1, 2], "b": [1, 2], "c": "b", "d": {"e": [1, 2]}}


FEW_NODES = 5000
"""Instead of a million, which take seconds to read."""


def _laughs(levels, width):
    rows = [f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * width)}]\n" for level in range(1, levels)]
    return "a0: &a0 [1]\n" + "".join(rows)


FAULTS = [
    ("a: !!bool abc", "at line 1: the tag '!!bool' is not read: leave it out"),
    ("a: 1\nb: !!timestamp abc", "at line 2: the tag '!!timestamp' is not read"),
    ("a: !!python/object:os.system {}", "the tag '!!python/object:os.system' is not read"),
    ("a: !!str [1]", "the tag '!!str' is not read"),
    ("a: *b", "at line 1: nothing before it has the anchor 'b'"),
    ("a: &a [*a]", "nothing before it has the anchor 'a'"),
    ("a: 1\na: 2", "at line 2: the key 'a' is there twice"),
    ("a" * 101 + ": 1", "at line 1: a key must be one line of at most 100 characters"),
    ('"a\\nb": 1', "at line 1: a key must be one line"),
    ("a: !" + "b" * 500 + " 1", "bbb...bbb"),
    ("[a]: 1", "at line 1: a key must be text"),
    ("a: 1\n---\nb: 2", "at line 2: a second document begins: keep one"),
    ("a: [1", "this is not YAML at line 2: "),
    ("a: 1\0", "this is not YAML: unacceptable character #x0000"),
    ("a: \ud800", "this is not YAML: "),
    ("- 1", "must hold keys and values"),
    ("", "must hold keys and values"),
    (
        "a: " + "[" * MOST_LEVELS + "]" * MOST_LEVELS,
        f"more than {MOST_LEVELS} lists and mappings lie within each other",
    ),
    (_laughs(MOST_LEVELS, 1), f"more than {MOST_LEVELS} lists and mappings lie within each other"),
    (_laughs(9, 9), f"there are more than {FEW_NODES} keys and values"),
    ("a: [" + "1," * FEW_NODES + "]", f"there are more than {FEW_NODES} keys and values"),
    ("#" * (MOST_CHARACTERS + 1), f"characters, more than {MOST_CHARACTERS}"),
]


@pytest.mark.parametrize(("text", "sentence"), FAULTS, ids=[text[:20] for text, _ in FAULTS])
def test_a_fault_is_one_short_sentence(monkeypatch, text, sentence):
    """It tells the line where there is one, and repeats little of a long text."""
    monkeypatch.setattr(yaml_document, "MOST_NODES", FEW_NODES)
    with pytest.raises(InputError) as problem:
        parse_mapping(text)
    assert sentence in str(problem.value)
    assert "\n" not in str(problem.value) and len(str(problem.value)) < 200


def test_what_keeps_to_the_bounds_is_read():
    """As deep as may be, and the covariance of the largest array, of 64 sensors, of which a twelfth is read here."""
    assert parse_mapping("a: " + "[" * (MOST_LEVELS - 1) + "]" * (MOST_LEVELS - 1))
    rows = parse_mapping("a:\n" + ("- [" + "-1.2345678901234567e-9, " * 768 + "]\n") * 64)["a"]
    assert 12 * sum(map(len, rows)) < MOST_NODES and 12 * sum(map(len, rows)) * 25 < MOST_CHARACTERS


def test_depth_ends_no_process():
    """100 000 lists within each other are a sentence, where a parser that calls itself is ended by the system."""
    code = (
        "from tam_calibration.files.yaml_document import parse_mapping\n"
        "for opening in ('[', '{a: ', '- ', '? ', '&a [', '!!bool [', '[*a,'):\n"
        "    try:\n"
        "        parse_mapping('a: 1\\nb:\\n  ' + opening * 100_000)\n"
        "    except ValueError as problem:\n"
        "        print(problem)\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (ended.returncode, ended.stderr) == (0, "")
    sentences = ended.stdout.splitlines()
    assert len(sentences) == 7 and all(each.startswith("this is not YAML at line 3: ") for each in sentences)


_YAML_LIKE = st.lists(
    st.sampled_from(
        [*"[]{},:-?&*!|>'\"%@#~ \n\t", "- ", ": ", "a", "&a ", "*a", "!!int ", "<<", "\n  ", "1e9", "---\n", "...\n"]
    ),
    max_size=40,
).map("".join)


@settings(max_examples=50)
@given(st.one_of(st.text(), _YAML_LIKE, st.text(alphabet=st.characters(codec="utf-16", exclude_categories=[]))))
def test_any_text_is_a_mapping_or_a_fault(text):
    """Nothing but `InputError` is raised, and what is read holds plain values only."""
    try:
        content = parse_mapping(text)
    except InputError as problem:
        assert "\n" not in str(problem)
    else:
        assert isinstance(content, dict) and all(map(_is_plain, content.values()))


def _is_plain(value):
    if isinstance(value, dict):
        return all(type(key) is str for key in value) and all(map(_is_plain, value.values()))
    if isinstance(value, list):
        return all(map(_is_plain, value))
    return value is None or type(value) in (str, int, float, bool)


_LETTERS = st.characters(min_codepoint=32, max_codepoint=0x2000, exclude_characters="\x85")
_PRINTED = st.text(alphabet=_LETTERS)
_LOOKS_LIKE = st.sampled_from(["1e5", "0o17", "0x1F", "on", "1:30", "2016-01-15", "~", "null", ".5", "", "=", "<<"])
_KEYS = st.one_of(st.text(alphabet=_LETTERS, max_size=LONGEST_KEY).filter(str.isprintable), _LOOKS_LIKE)
_VALUES = st.recursive(
    st.one_of(
        st.none(), st.booleans(), st.integers(-(2**64), 2**64), st.floats(allow_nan=False), _PRINTED, _LOOKS_LIKE
    ),
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(_KEYS, inner, max_size=4)),
    max_leaves=8,
)


@given(st.dictionaries(_KEYS, _VALUES, max_size=5))
def test_what_is_written_reads_back(content):
    """Numbers to the bit, and text as text, whatever it looks like."""
    assert parse_mapping(dump_mapping(content)) == content
