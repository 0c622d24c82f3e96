"""The sensor array."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.model.array import OUTPUT_NAMES, TENSOR_OUTPUTS, Array, KnownNoiseArray
from tam_calibration.model.exceptions import InputError

GRADIENT_ELEMENTS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def trace_free(elements):
    """Return the symmetric, trace-free tensor of xx, xy, xz, yy, yz."""
    xx, xy, xz, yy, yz = elements
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, -xx - yy]])


def test_cross_numbers_its_sensors_as_wu():
    """Sensors 1, 3 lie at +x, -x and 2, 4 at +y, -y, half a baseline from the centre."""
    expected = [[0.25, 0, 0], [0, 0.25, 0], [-0.25, 0, 0], [0, -0.25, 0]]
    assert_allclose(Array.cross(0.5).positions_m, expected)


@pytest.mark.parametrize("baseline", [0.05, 2.0])
def test_operator_of_the_cross_is_li_2018a_equation_2(baseline):
    """Centre and tensor are the mean and the differences over the baseline, xy the mean of its two."""
    first, second, third, fourth = readings = np.random.default_rng(3).uniform(-1, 1, (4, 3))
    along_x, along_y = (first - third) / baseline, (second - fourth) / baseline
    xy = (along_x[1] + along_y[0]) / 2
    tensor = [along_x[0], xy, along_x[2], along_y[1], along_y[2], -along_x[0] - along_y[1]]
    outputs = Array.cross(baseline).operator @ readings.ravel()
    assert_allclose(outputs, [*readings.mean(axis=0), *tensor], atol=1e-12 / baseline)


@pytest.mark.parametrize("count", [4, 5, 7])
def test_operator_is_exact_on_a_linear_field(count):
    """Wherever the sensors are, a field with a constant Maxwell gradient comes out as it is, at the origin."""
    rng = np.random.default_rng(count)
    positions, center, tensor = rng.uniform(-1, 1, (count, 3)), rng.uniform(-1, 1, 3), trace_free(rng.uniform(-1, 1, 5))
    outputs = Array(positions).operator @ (center + positions @ tensor).ravel()
    assert_allclose(outputs, [*center, *(tensor[i, j] for i, j in GRADIENT_ELEMENTS)], atol=1e-9)


def test_noise_floor_of_the_cross():
    """White noise of 1 nT with a baseline of 0.5 m makes 2.83 nT/m, for xy 2.00, together 6.00, and 0.50 nT."""
    noise = np.linalg.norm(Array.cross(0.5).operator, axis=1)
    by_name = dict(zip(OUTPUT_NAMES, noise, strict=True))
    assert_allclose([by_name[name] for name in ("gxx", "gyy", "gyz", "gxz")], np.sqrt(8))
    assert_allclose(by_name["gxy"], 2.0)
    assert_allclose([by_name[name] for name in ("bx", "by", "bz")], 0.5)
    # √(4·8 + 4); with the scale factors of Wu 2025 Table 1 it becomes 5.99.
    assert_allclose(np.linalg.norm(noise[list(TENSOR_OUTPUTS)]), 6.0)


@pytest.mark.parametrize("count", [1, 2])
def test_few_sensors_have_a_centre_but_no_gradient(count):
    """One or two sensors give their mean; what they cannot know is NaN, not a number."""
    array = Array(np.arange(3.0 * count).reshape(count, 3))
    assert not array.has_gradient
    readings = np.arange(3.0 * count)
    outputs = array.operator @ readings
    assert_allclose(outputs[:3], readings.reshape(count, 3).mean(axis=0))
    assert np.isnan(outputs[3:]).all()


def test_sensors_on_a_line_have_no_gradient():
    """Four sensors along x see no yy."""
    assert not Array(np.outer([-1, 0, 1, 2], [1, 0, 0])).has_gradient


@pytest.mark.parametrize("size", [1e-3, 1.0, 100.0])
def test_geometry_decides_about_the_gradient_at_every_size(size):
    """A cross of a millimetre has a gradient as one of 100 m has."""
    assert Array.cross(size).has_gradient


def test_geometry_is_compared_to_a_micrometre():
    """Noise does not matter, a tenth of a millimetre does, and so does the number of sensors."""
    cross = Array.cross(0.5, 1e-9)
    assert cross.has_geometry_of(Array.cross(0.5))
    assert not cross.has_geometry_of(Array.cross(0.5002))
    assert not cross.has_geometry_of(Array(cross.positions_m[:3]))


@pytest.mark.parametrize(("one", "count"), [(2, 1), (2e-9, 3), (np.float64(2e-9), 4), (np.array(2e-9), 4)])
def test_one_number_holds_for_all_sensors(one, count):
    """As a noise of each and as a delay of each, whatever the number of sensors."""
    small = 1e-9 * one
    array = Array(np.eye(4, 3)[:count], vector_noise_T=small, delay_s=small)
    assert_array_equal(array.vector_noise_T, np.full(count, small))
    assert_array_equal(array.delay_s, np.full(count, small))
    assert array.with_noise(3e-9, 0.0).vector_noise_T.shape == (count,)


POSITIONS = np.zeros((2, 3))


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: Array(np.zeros(3)), r"K rows of x, y, z; its shape is \(3,\)"),
        (lambda: Array(np.zeros((0, 3))), r"K rows of x, y, z; its shape is \(0, 3\)"),
        (lambda: Array(np.zeros((4, 2))), r"K rows of x, y, z; its shape is \(4, 2\)"),
        (lambda: Array(np.array([[0, np.nan, 0]])), "positions_m contains a value that is not finite"),
        (lambda: Array(POSITIONS, np.ones(3)), r"one value for each of .*2 sensors, not .*shape \(3,\)"),
        (lambda: Array(POSITIONS, np.array([1e-9, 0])), "every vector noise must be a positive number"),
        (
            lambda: Array(POSITIONS, np.array([1e-9, np.inf])),
            "for each of 2 sensors, and contains one that is not finite",
        ),
        (lambda: Array(POSITIONS, float("nan")), "for each of 2 sensors, and contains one that is not finite"),
        (lambda: Array(POSITIONS, -1e-9), "every vector noise must be a positive number"),
        (lambda: Array(POSITIONS, axis_offsets_m=0.0), r"needs three rows .* not the shape \(\)"),
        (lambda: Array(np.eye(3), scalar_position_m=0.1), r"must be three finite numbers x, y, z, not the shape \(\)"),
        (lambda: Array(POSITIONS, None, -1e-9), "scalar noise must be zero or a positive number"),
        (lambda: Array(POSITIONS, None, float("nan")), "scalar noise must be zero or a positive number"),
        (lambda: Array.cross(0.0), "baseline must be a positive number of metres, not 0"),
        (lambda: Array.cross(float("inf")), "baseline must be a positive number of metres, not inf"),
    ],
)
def test_impossible_arrays_are_refused(make, sentence):
    """Each wrong value is named with what would be right."""
    with pytest.raises(InputError, match=sentence):
        make()


def test_axes_that_are_not_in_one_place_are_allowed_for():
    """In a linear field, each axis reading it where its element sits, centre and tensor are exact; otherwise not."""
    offsets = 0.02 * np.random.default_rng(5).uniform(-1, 1, (4, 3, 3))
    array = Array(Array.cross(0.5).positions_m, axis_offsets_m=offsets)
    center = np.array([1.0, -2.0, 3.0])
    tensor = np.array([[1.0, 0.5, -0.3], [0.5, -2.0, 0.7], [-0.3, 0.7, 1.0]])
    fields = center + array.element_positions_m @ tensor
    readings = np.diagonal(fields, axis1=1, axis2=2).ravel()
    expected = np.concatenate([center, tensor[np.triu_indices(3)]])
    assert_allclose(array.operator @ readings, expected, atol=1e-12)
    assert np.abs(Array.cross(0.5).operator @ readings - expected).max() > 0.01
    assert not array.has_geometry_of(Array.cross(0.5))
    with pytest.raises(InputError, match="three rows"):
        Array(np.eye(3), axis_offsets_m=np.zeros(3))


def test_an_array_of_known_noise_holds_all_that_the_array_does():
    """Positions, offsets and bounds stay; copies with other values stay arrays of known noise."""
    stated = replace(Array.cross(0.5), scalar_position_m=np.array([0.1, 0, 0]))
    known = stated.with_noise(np.full(4, 2e-9), 1e-10)
    assert isinstance(known, KnownNoiseArray) and isinstance(replace(known, scalar_noise_T=0.0), KnownNoiseArray)
    assert_allclose(known.vector_noise_T, 2e-9)
    assert known.scalar_noise_T == 1e-10 and known.has_geometry_of(stated)
    assert_allclose(known.scalar_position_m, stated.scalar_position_m)


def test_noise_that_is_not_stated_is_asked_for():
    """In a sentence; where it is stated, a scalar magnetometer that is not there has none."""
    with pytest.raises(InputError, match="vector noise is not stated: add vector_noise_nT"):
        Array.cross(0.5).with_stated_noise()
    assert Array.cross(0.5, 1e-9).with_stated_noise().scalar_noise_T == 0
