"""The gap file holds what programs were promised, in units of files."""

import json
import math
from dataclasses import replace

import pytest

from tam_calibration.correction.parts import Provenance
from tam_calibration.effects.effect import Limit, Sized
from tam_calibration.gap.checks import checks_of
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution, FittedEffect
from tam_calibration.results.results_json import gap_to_mapping, numbers_of, write_gap


def test_the_keys_are_those_of_the_schema(gap):
    """Names and nesting are fixed; what is added stands beside them."""
    content = gap_to_mapping(gap)
    assert list(content)[:2] == ["schema", "verdict"]
    assert content["schema"] == "tam_calibration/gap/1" and content["verdict"] == "explained"
    assert {"gap", "where", "causes", "considered", "next_recording", "probabilities"} < set(content)
    fields = {f"{name}{unit}" for name in ("before", "after") for unit in ("", "_nT", "_nT_per_m")}
    assert set(content["gap"]) == fields | {"closed", "closed_interval", "floor_nT"}
    assert set(content["where"]) == {"sensors", "axes", "time_s", "frequency_hz", "evidence"}
    (cause,) = content["causes"]
    assert set(cause) == {
        "effect",
        "sensors",
        "axes",
        "probability",
        "share",
        "parameters",
        "evidence",
        "indistinguishable_from",
        "sizes",
    }
    assert cause["evidence"] == {"delta_bic": 640.0, "r2_cv": 0.97}
    assert [set(each) for each in content["considered"]] == [{"effect", "status", "why", "evidence"}] * 4


def test_sizes_are_in_units_of_files(gap):
    """Tesla become nT, T/m nT/m; noise floors stay."""
    assert gap_to_mapping(gap)["gap"] == {
        "before": 1.9,
        "after": 0.08,
        "closed": 0.998,
        "closed_interval": [0.99, 1.0],
        "before_nT": 1.9,
        "after_nT": 0.08,
        "before_nT_per_m": 5.4,
        "after_nT_per_m": 0.22,
        "floor_nT": 1.0,
    }


def test_parameters_have_units_and_standard_errors(gap):
    """Each parameter is named for its sensor and axis, and comes with its unit."""
    parameters = numbers_of(gap.causes[0].fitted, gap.causes[0].units)
    assert list(parameters) == ["time constant", "sensor 2 x offset", "sensor 2 y offset", "sensor 2 z offset"]
    assert parameters["time constant"] == {"value": 60.0, "standard_error": 5.0, "unit": "s"}
    assert parameters["sensor 2 y offset"] == {"value": 2.0, "standard_error": 0.02, "unit": "nT/°C"}


def test_names_of_parameters_are_unique(gap):
    """Where coefficients of two terms are called alike, and where a shape is, the term tells them apart."""
    parts = (
        Contribution(SCALAR, None, "step 1", {"height": 1e-9}),
        Contribution(SCALAR, None, "step 2", {"height": 2e-9}),
        Contribution(ALL, 2, "step 1", {"height": 3e-9}),
    )
    fitted = FittedEffect("bias_jump", {"start_time_s": 12.5}, parts)
    parameters = numbers_of(fitted, {"height": "T", "start_time_s": "s"})
    assert list(parameters) == ["start time", "scalar step 1 height", "scalar step 2 height", "all sensors z height"]
    assert math.isnan(parameters["start time"]["standard_error"])


def test_checks_have_their_range_beside_them(gap):
    """Each row by sensor and axis, each statistic with the twin's range, and what departs in words; null without."""
    residue = gap.residue
    checks = checks_of(residue.time_s, residue.direction, residue.before, residue.floor_T)
    content = gap_to_mapping(replace(gap, checks=checks, remainder="It drifts."))
    assert content["remainder"] == "It drifts." and content["checks"]["departs"] == list(checks.sentences)
    assert [(row["sensor"], row["axis"]) for row in content["checks"]["rows"]][3::9] == [(2, "x"), ("scalar", None)]
    row = content["checks"]["rows"][3]
    assert row["lag_1_correlation"]["value"] > 0.8 > row["lag_1_correlation"]["twin"][1]
    assert len(row["autocorrelation"]) == 20 and row["line_Hz"] > 0
    assert gap_to_mapping(gap)["checks"] is None


def test_sizes_stand_beside_the_largest_known(gap):
    """In units of files, with the source."""
    sized = Sized("offset", -2e-8, Limit(1e-6, "a book", "T"))
    (cause,) = gap_to_mapping(replace(gap, causes=(replace(gap.causes[0], sizes=(sized,)),)))["causes"]
    expected = {"name": "offset", "value": 20.0, "largest_known": 1000.0, "unit": "nT", "source": "a book"}
    assert cause["sizes"] == [expected]


def test_numbers_are_finite_or_null(gap, tmp_path):
    """What is not known is null in the file, which is whole, and the same whenever it is written."""
    size = replace(gap.size, before_T_per_m=math.nan, after_T_per_m=math.nan)
    where = replace(gap.where, sensors=("scalar",), axes=(), time_s=(1.7e9, 1.7e9 + 0.125))
    unknown = replace(gap, size=size, where=where)
    write_gap(tmp_path / "gap.json", unknown, Provenance("run.csv", 12, "ab"))
    text = (tmp_path / "gap.json").read_text()
    content = json.loads(text, parse_constant=pytest.fail)
    assert content["gap"]["before_nT_per_m"] is None
    assert content["where"]["evidence"] == {"differential": 1.9, "common_mode": None}
    assert content["where"]["time_s"] == [1.7e9, 1.7e9 + 0.125]
    assert content["where"]["sensors"] == ["scalar"]
    assert content["recording"] == {"name": "run.csv", "size_bytes": 12, "sha256": "ab"}
    write_gap(tmp_path / "gap.json", unknown, Provenance("run.csv", 12, "ab"))
    assert (tmp_path / "gap.json").read_text() == text
    assert [path.name for path in tmp_path.iterdir()] == ["gap.json"]
