"""A mend is read as it was written, from its own file and from a comparison's; what is wrong is told in a sentence."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mends import EFFECTS, mend_of, run_of
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.comparison.additions import mended
from tam_calibration.comparison.mend import NoiseTerm
from tam_calibration.files.text_files import to_json
from tam_calibration.files.yaml_document import dump_mapping, parse_mapping
from tam_calibration.model.exceptions import InputError
from tam_calibration.results.comparison_json import SCHEMA, mend_to_mapping, read_mend, write_mend
from tam_calibration.results.comparison_json import mend_of as mend_of_mapping

NOISE = (
    NoiseTerm(1, "x", 1.1e-9, 0.3e-9, knee_hz=0.7, exponent=1.3),
    NoiseTerm(2, "z", 1e-9, 0.0, band_hz=(4.0, 5.5), band_T=2e-9),
    NoiseTerm(0, "", 1e-10, 0.0),
)


@pytest.fixture(scope="module")
def run():
    """Return a run with every channel."""
    return run_of(200)


@pytest.fixture(scope="module")
def mend(run):
    """Return a mend with every effect of ours, and noise of every kind."""
    return mend_of(run, EFFECTS.values(), NOISE, ["time_skew", "quantization"])


def same(one, other):
    """Whether two mends have the same effects, noise and names, to the last bit."""
    numbers = one.added == other.added and one.removed == other.removed and one.rate_hz == other.rate_hz
    return numbers and repr(one.noise) == repr(other.noise)


def test_a_file_is_read_as_it_was_written(tmp_path, run, mend):
    """Effects and noise are the same to the last bit, so that they make the same readings."""
    path = tmp_path / "mend.yaml"
    write_mend(path, mend)
    read = read_mend(path)
    assert same(read, mend)
    assert_allclose(
        read.calibration.errors.matrix, mend.calibration.errors.matrix, rtol=1e-15
    )  # degrees, there and back
    assert_array_equal(mended(run, read, 3).readings_T, mended(run, mend, 3).readings_T)


def test_people_read_units(mend):
    """The schema stands first, fields are in nT, and keys and values say so."""
    text = dump_mapping(mend_to_mapping(mend))
    assert text.startswith(f"schema: {SCHEMA}\n")
    assert "added_white_nT: 0.3" in text and "knee_hz: 0.7" in text and "offset: 7.0 nT/K" in text


@settings(max_examples=20)
@given(
    white=st.floats(0, 1e-3),
    added=st.floats(0, 1e-3),
    slow=st.none() | st.tuples(st.floats(1e-6, 1e3), st.floats(0.1, 5)),
    band=st.none() | st.tuples(st.floats(1e-3, 10), st.floats(11, 100), st.floats(0, 1e-6)),
)
def test_any_noise_is_read_as_it_was_written(mend, white, added, slow, band):
    """Its frequencies are exact, and its sizes to the last bit that nanotesla have."""
    term = NoiseTerm(3, "y", white, added)
    if slow:
        term = replace(term, knee_hz=slow[0], exponent=slow[1])
    if band:
        term = replace(term, band_hz=band[:2], band_T=band[2])
    own = replace(mend, added=(), noise=(term,))
    read = mend_of_mapping(parse_mapping(dump_mapping(mend_to_mapping(own)))).noise[0]
    assert read.band_hz == term.band_hz
    assert_array_equal([read.knee_hz, read.exponent], [term.knee_hz, term.exponent])
    sizes = [[one.white_T, one.added_white_T, one.band_T] for one in (read, term)]
    assert_allclose(*sizes, rtol=1e-15, atol=1e-30)


def test_the_json_of_a_comparison_holds_the_same(tmp_path, mend):
    """Its mend is read, where JSON has null for NaN too."""
    covariance = replace(mend.calibration, reduced_chi_square={"differential": float("nan")})
    unknown = replace(mend, calibration=covariance)
    path = tmp_path / "compare.json"
    content = {"schema": "tam_calibration/compare/1", "mend": {"parameters": mend_to_mapping(unknown)}}
    path.write_text(to_json(content))
    assert (
        json.loads(path.read_text())["mend"]["parameters"]["calibration"]["reduced_chi_square"]["differential"] is None
    )
    read = read_mend(path)
    assert same(read, mend)
    assert np.isnan(read.calibration.reduced_chi_square["differential"])
    assert read.calibration.source is None


def changed(mend, **keys):
    """Return the mapping of a mend with other keys."""
    return mend_to_mapping(replace(mend, added=())) | keys


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        ({"schema": "tam_calibration/mend/9"}, "has the schema 'tam_calibration/mend/9'"),
        ({"rate_hz": 0.0}, "rate_hz"),
        ({"removed": ["magic"]}, "there is no effect 'magic'"),
        ({"added": [{"effect": "magic", "terms": []}]}, "there is no effect 'magic'"),
        (
            {"added": [{"effect": "time_skew", "terms": [{"sensor": 1, "term": "late", "values": {}}]}]},
            "'late' is none",
        ),
        ({"noise": [{"sensor": 9, "axis": "x", "white_nT": 1, "added_white_nT": 0}]}, "beyond the 4"),
        ({"noise": [{"sensor": 1, "white_nT": 1, "added_white_nT": 0}]}, "with its axis"),
        ({"noise": [{"sensor": 1, "axis": "x", "white_nT": 1, "added_white_nT": 0, "knee_hz": 2}]}, "by both knee_hz"),
        (
            {"noise": [{"sensor": 1, "axis": "x", "white_nT": 1, "added_white_nT": 0, "band_hz": [3, 2]}]},
            "a lower and a higher frequency",
        ),
        ({"noise": [{"sensor": 1, "axis": "x", "white_nT": -1, "added_white_nT": 0}]}, "noise.1.white_nT"),
        ({"calibration": {}}, "calibration: this is no calibration"),
    ],
)
def test_bad_content_is_one_sentence(tmp_path, mend, keys, sentence):
    """It names the file and the fault."""
    path = tmp_path / "mend.yaml"
    path.write_text(dump_mapping(changed(mend, **keys)))
    with pytest.raises(InputError) as told:
        read_mend(path)
    assert str(told.value).startswith(str(path)) and sentence in str(told.value)
    assert len(str(told.value).splitlines()) == 1


@pytest.mark.parametrize("content", [{}, {"mend": None}, {"mend": {}}, {"mend": {"parameters": None}}])
def test_a_comparison_without_a_mend(tmp_path, content):
    """That there is none is told."""
    path = tmp_path / "compare.json"
    path.write_text(json.dumps({"schema": "tam_calibration/compare/1"} | content))
    with pytest.raises(InputError, match="this comparison has no mend"):
        read_mend(path)
