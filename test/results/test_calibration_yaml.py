"""The calibration file reads back as it was; one that was damaged is refused."""

import re
from dataclasses import replace

import numpy as np
import pytest
import yaml
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.correction.parts import EffectSize, Provenance
from tam_calibration.files.yaml_document import dump_mapping
from tam_calibration.fit import calibrate
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.fitted_effect import SCALAR, Contribution, FittedEffect
from tam_calibration.model.limits import is_covariance
from tam_calibration.model.recording import Recording
from tam_calibration.results import calibration_from_yaml, calibration_to_yaml, read_calibration, write_calibration
from tam_calibration.results.calibration_yaml import calibration_to_mapping


@pytest.fixture(scope="module")
def calibration(recording, cross):
    """Return a calibration of the cross with a source."""
    return replace(calibrate(recording, cross), source=Provenance("run.mcap", 12345, "ab" * 32), warnings=("a: b", "ü"))


@pytest.fixture(scope="module")
def text(calibration):
    """Return its file."""
    return calibration_to_yaml(calibration)


def test_the_calibration_that_is_read_corrects_alike(calibration, recording, tmp_path):
    """Corrected with the file, field and tensor differ by no more than the last bits of the readings."""
    write_calibration(tmp_path / "c.yaml", calibration)
    again = read_calibration(tmp_path / "c.yaml")
    expected, corrected = calibration.correct(recording), again.correct(recording)
    assert_allclose(corrected.outputs[:, :3], expected.outputs[:, :3], rtol=0, atol=1e-15 * 50e-6)
    assert_allclose(corrected.outputs[:, 3:], expected.outputs[:, 3:], rtol=0, atol=1e-15 * 50e-6 / 0.25)
    assert_array_equal(corrected.standard_errors, expected.standard_errors)


def test_everything_reads_back(calibration, text):
    """Names, figures, statements and covariance of the file are those of the calibration."""
    again = calibration_from_yaml(text, "text")
    exact = (
        "method",
        "noise_is_estimated",
        "has_scalar_reference",
        "samples",
        "time_span_s",
        "source",
        "warnings",
        "statements",
    )
    for name in exact:
        assert getattr(again, name) == getattr(calibration, name)
    assert_array_equal(again.covariance, calibration.covariance)
    assert_array_equal(again.array.positions_m, calibration.array.positions_m)
    assert_allclose(again.errors.to_vector(), calibration.errors.to_vector(), rtol=3e-16)
    assert_allclose(again.intensity_T, calibration.intensity_T, rtol=3e-16)
    assert_allclose(again.coverage, calibration.coverage, rtol=1e-5)
    assert again.reduced_chi_square == pytest.approx(calibration.reduced_chi_square, rel=1e-5)
    for name in ("before", "in_sample", "held_out", "floor"):
        stored, original = getattr(again, name), getattr(calibration, name)
        assert_allclose(stored.sensor_intensity_T, original.sensor_intensity_T, rtol=1e-5)
        assert_allclose(stored.center_intensity_T, original.center_intensity_T, rtol=1e-5)
        assert_allclose(stored.tensor_T_per_m, original.tensor_T_per_m, rtol=1e-5)


def test_it_is_readable_by_hand(calibration, text):
    """The readings are corrected with nothing but matrix and bias of the file, as its formula says."""
    content = yaml.safe_load(text)
    reading_nT = np.array([100.0, -20000.0, 45000.0])
    for sensor, block in enumerate(content["sensors"]):
        field_nT = np.linalg.solve(block["matrix"], reading_nT - block["bias_nT"])
        raw = np.zeros((1, 4, 3))
        raw[0, sensor] = reading_nT * 1e-9
        assert_allclose(calibration.errors.restore(raw)[0, sensor], field_nT * 1e-9, rtol=1e-12)
    assert "inverse of its matrix" in content["formula"]
    assert content["recording"]["sha256"] == "ab" * 32


def test_one_sensor_without_scalar_reads_back(recording):
    """A calibration without tensor, scalar reference, source or held-out residuals reads back."""
    single = Recording(recording.time_s, recording.readings_T[:, :1])
    calibration = replace(calibrate(single, Array(np.zeros((1, 3)), np.array([1e-9]))), held_out=None)
    again = calibration_from_yaml(calibration_to_yaml(calibration), "text")
    assert again.held_out is None and again.source is None
    assert np.isnan(again.in_sample.tensor_T_per_m).all()
    assert_array_equal(again.array.vector_noise_T, calibration.array.vector_noise_T)


def test_a_file_from_before_the_gradient_was_an_effect_reads(calibration):
    """Its gradient of the site is left out."""
    mapping = calibration_to_mapping(calibration)
    mapping["field"] |= dict.fromkeys(("gradient_nT_per_m", "gradient_standard_error_nT_per_m"), [[1.0, 2.0, 3.0]] * 3)
    again = calibration_from_yaml(dump_mapping(mapping), "text")
    assert_allclose(again.errors.to_vector(), calibration.errors.to_vector(), rtol=1e-12)


def damage(text, pattern, replacement):
    """Return the text with the first match of a pattern replaced."""
    damaged = re.sub(pattern, replacement, text, count=1, flags=re.DOTALL)
    assert damaged != text
    return damaged


@pytest.mark.parametrize(
    ("pattern", "replacement", "sentence"),
    [
        ("calibration/1", "calibration/2", "it has the schema 'tam_calibration/calibration/2', not"),
        ("schema: [^\n]*\n", "", "it has no schema"),
        ("method: [^\n]*\n", "", "the key 'method' is missing"),
        ("method:", "methods: 3\nmethod:", "the key 'methods' is not known"),
        (r"bias_nT: \[", "bias_nT: [1.0, ", "sensors.1.bias_nT"),
        (r"bias_nT: \[[^,]*", "bias_nT: [lots", "sensors.1.bias_nT.1: input should be a valid number"),
        (r"bias_nT: \[[^,]*", "bias_nT: [.nan", "sensors.1.bias_nT.1: input should be a finite number"),
        (r"scale_factor: \[[01]", "scale_factor: [2", "matrix and parameters of sensor 1 contradict each other"),
        (r"- sensor: 2", "- sensor: 7", "sensors must be numbered 1, 2"),
        (
            r"vector_noise_nT: \[1.0, ",
            "vector_noise_nT: [",
            "vector noise needs one value for each of 4 sensors",
        ),
        (r"(covariance_SI:\n- \[[^,]*),", r"\1, 0.0,", "covariance_SI must have 48 rows of 48 numbers"),
        (r"covariance_SI:\n- \[", "covariance_SI:\n- [-", "covariance_SI must be symmetric"),
        ("covariance_order.*", "", "the key 'covariance_order' is missing"),
        (r"\n- sensor: 3.*", "\n- sensor: [", "this is not YAML"),
        (".*", "just words", "must hold keys and values"),
    ],
)
def test_a_damaged_file_is_one_sentence(text, pattern, replacement, sentence):
    """A file of another version, truncated or edited by hand is refused, with its name and the place."""
    with pytest.raises(InputError, match=sentence) as problem:
        calibration_from_yaml(damage(text, pattern, replacement), "c.yaml")
    assert str(problem.value).startswith("c.yaml: ")
    assert "\n" not in str(problem.value)


def _spoiled(covariance, way):
    """Return a covariance that no fit can have."""
    spoiled, deviation = covariance.copy(), np.sqrt(np.diag(covariance))
    if way == "correlated":  # beyond 1 with each other
        spoiled[0, 1] = spoiled[1, 0] = 1.01 * deviation[0] * deviation[1]
    elif way == "in three":  # each pair could be, all three cannot
        spoiled[:3, :3] = np.outer(deviation[:3], deviation[:3]) * (1.9 * np.eye(3) - 0.9)
    elif way == "asymmetric":
        spoiled[0, 1] += 0.1 * deviation[0] * deviation[1]
    elif way == "of what was held fixed":
        spoiled[0, 0] = 0.0
    else:
        spoiled[5, 5] *= -1
    return spoiled


@pytest.mark.parametrize("way", ["correlated", "in three", "asymmetric", "of what was held fixed", "negative"])
def test_a_covariance_that_is_none_is_refused(calibration, way):
    """It must be symmetric and positive definite, but for what was held fixed."""
    assert is_covariance(calibration.covariance)
    content = calibration_to_mapping(calibration)
    content["covariance_SI"] = _spoiled(calibration.covariance, way).tolist()
    with pytest.raises(InputError, match=r"^c\.yaml: .*covariance_SI must be symmetric and positive definite$"):
        calibration_from_yaml(dump_mapping(content), "c.yaml")


def test_a_scalar_without_noise_is_refused(calibration):
    """Where there is a scalar reference; an older file without one states 0."""
    text = damage(calibration_to_yaml(calibration), "scalar_noise_nT: [^\n]*", "scalar_noise_nT: 0.0")
    with pytest.raises(InputError, match="scalar_noise_nT must be greater than 0: leave it out"):
        calibration_from_yaml(text, "c.yaml")
    without = damage(text, "has_scalar_reference: true", "has_scalar_reference: false")
    assert calibration_from_yaml(without, "c.yaml").array.scalar_noise_T == 0.0


@pytest.mark.parametrize(
    ("pattern", "replacement"),
    [
        ("scale_factor_standard_error: \\[", "scale_factor_standard_error: [-"),
        ("(in_sample:\n    sensor_intensity_nT: \\[)", "\\1-"),
        ("differential: ", "differential: -"),
        ("(vector_noise_nT: \\[)", "\\1-"),
    ],
)
def test_a_size_that_is_negative_is_refused(text, pattern, replacement):
    """Standard errors, residuals and noise have no sign."""
    with pytest.raises(InputError, match=r"greater than or equal to 0|must be a positive number"):
        calibration_from_yaml(damage(text, pattern, replacement), "c.yaml")


def test_unknown_numbers_are_null(recording):
    """Of a line of sensors, which measures no gradient tensor: the file says so, and holds no NaN."""
    for places in (np.outer([1, 0, -1], [0.3, 0, 0]), np.outer([1, 2, 3], [0.1, 0.1, 0.1]), [[0, 0, 0.3], [0, 0, 0]]):
        line = Recording(recording.time_s, recording.readings_T[:, : len(places)], recording.scalar_T)
        calibration = calibrate(line, Array(places, 1e-9, 1e-10))
        text = calibration_to_yaml(calibration)
        assert "nan" not in text.lower() and "tensor_rmse_nT_per_m: null" in text
        assert len(places) < 3 or "so the outputs have no gradient" in text
        assert np.isnan(calibration_from_yaml(text, "text").in_sample.tensor_T_per_m).all()
        old = text.replace("null, null, null, null, null", ".nan, .nan, .nan, .nan, .nan")
        assert np.isnan(calibration_from_yaml(old, "text").in_sample.tensor_T_per_m).all()


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_refused(text, part):
    """Wherever the file was cut, it is not taken for a calibration."""
    with pytest.raises(InputError):
        calibration_from_yaml(text[: int(len(text) * part)], "c.yaml")


def test_effects_read_back(calibration, recording):
    """Effects keep their numbers and standard errors to the last bit, in units for people; sizes to six digits."""
    drift = FittedEffect(
        "temperature_drift",
        {"time_constant_s": 12.3456789, "reference_C": 21.5},
        (
            Contribution(1, 0, "offset", {"offset": 1.23456789e-9}, {"offset": 1.1e-11}),
            Contribution(1, 2, "scale", {"scale": 2.5e-5}, {"scale": 3e-7}),
        ),
        {"time_constant_s": 0.7},
    )
    current = FittedEffect(
        "current_interference",
        {"reference_A": 0.5},
        (Contribution(SCALAR, None, "field", {"field x": 1e-10, "field y": 0.0, "field z": -2e-10}),),
    )
    sizes = tuple(EffectSize(np.arange(9) * 1.111111e-9, np.arange(9) * 1e-11) for _ in range(2))
    keeping = replace(calibration, effects=(drift, current), effect_sizes=sizes)
    text = calibration_to_yaml(keeping)
    assert "offset: 1.23456789 nT/K" in text and "time_constant_s: 12.3456789 s" in text and "sensor: scalar" in text
    again = calibration_from_yaml(text, "text")
    assert again.effects == keeping.effects
    assert_allclose([size.rms for size in again.effect_sizes], [size.rms for size in sizes], rtol=1e-5)
    assert_allclose(again.output_standard_errors, keeping.output_standard_errors, rtol=1e-6)
    warming = replace(recording, temperature_C=np.linspace(10, 30, recording.sample_count))
    assert_allclose(again.correct(warming).outputs, keeping.correct(warming).outputs, rtol=0, atol=1e-17)


@pytest.mark.parametrize(
    ("found", "put", "sentence"),
    [
        ("term: offset", "term: ofset", "'ofset' is none of the terms of temperature_drift: they are offset"),
        ("offset: 1.23", "ofset: 1.23", "'ofset' is no value of the term 'offset' of temperature_drift"),
        ("reference_C: 21.5", "reference_K: 21.5", "temperature_drift needs the value 'reference_C'"),
        ("effect: temperature_drift", "effect: tides", "there is no effect 'tides'"),
    ],
)
def test_an_effect_without_its_numbers_is_refused(calibration, found, put, sentence):
    """A slip of the pen in an effect is told with the file's name, before any sample comes."""
    drift = FittedEffect(
        "temperature_drift",
        {"time_constant_s": 12.0, "reference_C": 21.5},
        (Contribution(1, 0, "offset", {"offset": 1.23e-9}, {"offset": 1e-11}),),
    )
    size = EffectSize(np.zeros(9), np.zeros(9))
    text = calibration_to_yaml(replace(calibration, effects=(drift,), effect_sizes=(size,)))
    assert found in text
    with pytest.raises(InputError, match=sentence) as refused:
        calibration_from_yaml(text.replace(found, put, 1), "c.yaml")
    assert str(refused.value).startswith("c.yaml")


def test_a_file_of_before_effects_could_be_kept_has_none(text):
    """Files without effects are written and read as ever."""
    assert "effects" not in yaml.safe_load(text)
    assert calibration_from_yaml(text, "text").effects == ()
