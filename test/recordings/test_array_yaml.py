"""The array file: the cross by its baseline, any array by positions, and each fault by its key."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import EARTH_FIELD, FieldBounds
from tam_calibration.recordings import read_array, write_array
from tam_calibration.results.scenario import shipped_scenarios


@pytest.fixture
def read(tmp_path):
    """Return a function that reads a text as an array file."""

    def read(text):
        path = tmp_path / "array.yaml"
        path.write_text(text)
        return read_array(path)

    return read


def test_a_baseline_makes_the_cross(read):
    """The cross has one noise for all sensors; notes may hold anything."""
    array = read("baseline_m: 0.5\nvector_noise_nT: 1\nscalar_noise_nT: 0.1\nnotes: {a: [1, 2]}\nrecording: {b: c}\n")
    expected = Array.cross(0.5, 1e-9, 1e-10)
    assert_array_equal(array.positions_m, expected.positions_m)
    assert_array_equal(array.vector_noise_T, expected.vector_noise_T)
    assert array.scalar_noise_T == expected.scalar_noise_T


def test_the_field_is_the_earths_unless_the_file_says_otherwise(read, tmp_path):
    """The bounds of a shielded room come in nT, and are written as they were read."""
    assert read("baseline_m: 0.5\n").field == EARTH_FIELD
    array = read("baseline_m: 0.5\nintensity_nT: [1500, 2500]\n")
    assert array.field == FieldBounds(1.5e-6, 2.5e-6)
    write_array(tmp_path / "again.yaml", array)
    assert "intensity_nT: [1500.0, 2500.0]" in (tmp_path / "again.yaml").read_text()
    assert read_array(tmp_path / "again.yaml").field == array.field
    write_array(tmp_path / "earth.yaml", Array.cross(0.5))
    assert "intensity" not in (tmp_path / "earth.yaml").read_text()


def test_further_channels_are_named(read, tmp_path):
    """Those that the nodes listen to, in the order of columns; another name is refused, and none is written of none."""
    array = read("baseline_m: 0.5\nfurther_channels: [actuator_rudder, current_2_A]\n")
    assert array.further_channels == ("current_2_A", "actuator_rudder")
    write_array(tmp_path / "again.yaml", array)
    assert read_array(tmp_path / "again.yaml").further_channels == array.further_channels
    with pytest.raises(InputError, match="'rudder' is no further channel"):
        read("baseline_m: 0.5\nfurther_channels: [rudder]\n")
    write_array(tmp_path / "plain.yaml", Array.cross(0.5))
    assert "further" not in (tmp_path / "plain.yaml").read_text()


def test_sensors_are_a_millimetre_apart(read):
    """What is just that far apart is taken."""
    assert read("positions_m: [[0, 0, 0], [0, 0, 0.0011]]").sensor_count == 2


def test_positions_make_any_array(read):
    """Positions are taken as they are; noise may differ between sensors, or be unknown."""
    array = read("positions_m: [[0, 0, 1], [0, 0.5, 0]]\nvector_noise_nT: [1, 2.5]\n")
    assert array.positions_m.tolist() == [[0, 0, 1], [0, 0.5, 0]]
    assert array.vector_noise_T.tolist() == [1e-9, 2.5e-9]
    assert array.scalar_noise_T is None
    assert read("positions_m: [[0, 0, 0]]\n").vector_noise_T is None


def test_delays_are_one_for_each_sensor(read, tmp_path):
    """They are read in seconds and written as they were read; another number of them is refused."""
    array = read("positions_m: [[0, 0, 1], [0, 0.5, 0]]\ndelay_s: [0, 0.0123]\n")
    assert array.delay_s.tolist() == [0, 0.0123]
    write_array(tmp_path / "again.yaml", array)
    assert read_array(tmp_path / "again.yaml").delay_s.tolist() == [0, 0.0123]
    with pytest.raises(InputError, match="delay_s needs one finite number for each of 4 sensors"):
        read("baseline_m: 0.5\ndelay_s: [0, 0.1]\n")
    assert array.stamp_delay_s.tolist() == [0, 0.0123, 0]
    assert read("baseline_m: 0.5\ndelay_s: 0.02\n").delay_s.tolist() == [0.02] * 4


def test_the_scalar_has_a_delay_of_its_own(read, tmp_path):
    """It is the last of the delays of the stamps, also where the sensors have none."""
    array = read("baseline_m: 0.5\nscalar_delay_s: 0.03\n")
    write_array(tmp_path / "again.yaml", array)
    assert read_array(tmp_path / "again.yaml").stamp_delay_s.tolist() == [0, 0, 0, 0, 0.03]
    assert read("baseline_m: 0.5\n").stamp_delay_s is None
    with pytest.raises(InputError, match="scalar_delay_s must be a finite number of seconds"):
        read("baseline_m: 0.5\nscalar_delay_s: .inf\n")


def test_an_array_reads_back(tmp_path):
    """What is written reads back to the bit."""
    array = Array([[0.1, 0.2, 0.3], [0, 0, -1 / 3]], [1.7e-9, 3e-9], 1e-10, [0.1, -1 / 3, 2])
    write_array(tmp_path / "a.yaml", array)
    again = read_array(tmp_path / "a.yaml")
    assert_array_equal(again.positions_m, array.positions_m)
    assert_array_equal(again.vector_noise_T, array.vector_noise_T)
    assert again.scalar_noise_T == array.scalar_noise_T
    assert_array_equal(again.scalar_position_m, array.scalar_position_m)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "is empty"),
        ("baseline_m", "must hold keys and values"),
        ("baseline_m: [1", "this is not YAML at line 2: "),
        ("baseline_m: 0.5\nbaseline_m: 0.6", "this is not YAML at line 2: the key 'baseline_m' is there twice"),
        ("? [baseline_m]\n: 0.5", "this is not YAML at line 1: "),
        ("baselin_m: 0.5", "the key 'baselin_m' is not known; known are baseline_m, positions_m, vector_noise_nT"),
        ("baseline_m: wide", "baseline_m: input should be a valid number"),
        ("baseline_m: -1", "the baseline must be a positive number of metres"),
        ("baseline_m: 0.5\npositions_m: [[0, 0, 0]]", "give either baseline_m"),
        ("vector_noise_nT: 1", "give either baseline_m"),
        ("positions_m: []", "positions_m must be K rows of x, y, z"),
        ("positions_m: [[0, 0]]", "positions_m.1.3"),
        ("positions_m: [[0, 0, .nan]]", "positions_m contains a value that is not finite"),
        ("baseline_m: 0.5\nvector_noise_nT: [1, 1]", "vector noise needs one value for each of 4 sensors"),
        ("baseline_m: 0.5\nvector_noise_nT: 0", "every vector noise must be a positive number"),
        ("baseline_m: 0.5\nscalar_noise_nT: -1", "the scalar noise must be zero or a positive number"),
        ("baseline_m: 0.5\nscalar_noise_nT: 0", "scalar_noise_nT must be greater than 0: leave it out"),
        ("baseline_m: 0.5\nscalar_noise_nT: -0.0", "scalar_noise_nT must be greater than 0: leave it out"),
        (
            "baseline_m: 0.5\nscalar_position_m: [0, .inf, 0]",
            "position of the scalar magnetometer must be three finite",
        ),
        ("baseline_m: 0.5\nintensity_nT: 48000", "intensity_nT: input should be a valid list"),
        ("baseline_m: 0.5\nintensity_nT: [48000]", "the key 'intensity_nT.2' is missing"),
        ("baseline_m: 0.5\nintensity_nT: [1, 2, 3]", "intensity_nT: tuple should have at most 2 items"),
        ("baseline_m: 0.5\nintensity_nT: [weak, 48000]", "intensity_nT.1: input should be a valid number"),
        (
            "baseline_m: 0.5\nintensity_nT: [60000, 40000]",
            "the field's intensity .* not 60000 and 40000 nT: check their or",
        ),
        ("baseline_m: 0.5\nintensity_nT: [-1, 40000]", "not -1 and 40000 nT"),
        ("baseline_m: 0.5\nintensity_nT: [.nan, 40000]", "not nan and 40000 nT"),
        ("baseline_m: 0.5\nintensity_nT: [40, 60]", "not 40 and 60 nT: check their order and unit"),
        ("baseline_m: 0.5\nintensity_nT: [4.0e-5, 6.0e-5]", "not 4e-05 and 6e-05 nT: check their order and unit"),
        (
            "positions_m: [[0, 0, 0], [1, 0, 0], [1, 0, 0.0009]]",
            r"sensors 2 and 3 are both at \[1.0, 0.0, 0.0009\] m, where there is room for one",
        ),
        ("baseline_m: 0.5\nscalar_position_m: [0, 1]", "the key 'scalar_position_m.3' is missing"),
    ],
)
def test_a_fault_is_one_sentence(read, text, sentence):
    """Whatever is wrong with the file is told with its name and key."""
    with pytest.raises(InputError, match=sentence) as problem:
        read(text)
    assert "array.yaml" in str(problem.value)
    assert "\n" not in str(problem.value)


def test_rotations_are_angles_or_quaternions(read, tmp_path):
    """One for each sensor and one of the IMU, which are written as they were read; frames are names."""
    array = read(
        "baseline_m: 0.5\nrotations_deg: [[0, 0, 0], [0, 0, 90], [180, 0, 0], [0, 0, 0]]\n"
        "imu_rotation_quaternion: [0, 0, 1, 0]\nframe_ids: [a, b, c, d]\nimu_frame_id: imu_link\n"
    )
    half = np.sqrt(0.5)
    expected = [[0, 0, 0, 1], [0, 0, half, half], [1, 0, 0, 0], [0, 0, 0, 1]]
    assert_allclose(array.mounting.rotations, expected, atol=1e-15)
    assert array.mounting.imu_rotation.tolist() == [0, 0, 1, 0]
    write_array(tmp_path / "again.yaml", array)
    again = read_array(tmp_path / "again.yaml").mounting
    assert_array_equal(again.rotations, array.mounting.rotations)
    assert_array_equal(again.imu_rotation, array.mounting.imu_rotation)
    assert (again.frame_ids, again.imu_frame_id) == (("a", "b", "c", "d"), "imu_link")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("rotations_deg: [[0, 0, 0]]", "rotations needs one for each of 4 sensors, not 1"),
        ("rotations_deg: [[0, 0, .nan]]", "the rotation of sensor 1 is no rotation"),
        ("rotations_quaternion: [[0, 0, 0, 0]]", "the rotation of sensor 1 is no rotation"),
        ("imu_rotation_quaternion: [0, 0, 0, 0]", "the rotation of the IMU is no rotation"),
        ("imu_rotation_deg: [0, 0, 0]\nimu_rotation_quaternion: [0, 0, 0, 1]", "either imu_rotation_deg or"),
        ("rotations_deg: []\nrotations_quaternion: []", "either rotations_deg or rotations_quaternion"),
        ("rotations_deg: []", "rotations needs one for each of 4 sensors, not 0"),
        ("frame_ids: [a]", "frame_ids needs one for each of 4 sensors, not 1"),
    ],
)
def test_what_is_no_rotation_of_each_sensor_is_refused(read, text, sentence):
    """In one sentence that names it."""
    with pytest.raises(InputError, match=sentence):
        read(f"baseline_m: 0.5\n{text}\n")


POSES = {
    "left": (np.array([0, 0.5, 0]), np.array([0, 0, 1, 0])),
    "right": (np.array([0, -0.5, 0]), np.array([0, 0, 0, 1])),
    "imu": (np.zeros(3), np.array([1, 0, 0, 0])),
}


def test_a_file_without_positions_leaves_them_to_tf(tmp_path):
    """Positions and rotations are those of the frames; what a file states is never looked up."""
    path = tmp_path / "array.yaml"
    path.write_text("frame_ids: [left, right]\nimu_frame_id: imu\n")
    array = read_array(path, POSES.__getitem__)
    assert array.positions_m.tolist() == [[0, 0.5, 0], [0, -0.5, 0]]
    assert array.mounting.rotations.tolist() == [[0, 0, 1, 0], [0, 0, 0, 1]]
    assert array.mounting.imu_rotation.tolist() == [1, 0, 0, 0]
    with pytest.raises(InputError, match="names frame_ids and no positions"):
        read_array(path)
    path.write_text("frame_ids: [left, right]\nrotations_deg: [[0, 0, 0], [0, 0, 0]]\n")
    with pytest.raises(InputError, match="leave those out, or state both"):
        read_array(path, POSES.__getitem__)
    path.write_text("frame_ids: [left, right]\npositions_m: [[1, 0, 0], [0, 1, 0]]\nimu_frame_id: imu\n")
    stated = read_array(path, POSES.__getitem__)
    assert stated.positions_m.tolist() == [[1, 0, 0], [0, 1, 0]]
    assert stated.mounting.rotations is None and stated.mounting.imu_rotation is None


def test_a_scenario_is_told_by_its_name():
    """Who gives the scenario instead of the array is told which file it is."""
    scenario = shipped_scenarios()["auv"]
    with pytest.raises(InputError, match="it is a scenario: give the array file that tam simulate wrote"):
        read_array(scenario)
