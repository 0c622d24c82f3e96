"""A bag in which a sensor is dead for a part: corrected with the others, calibrated with whole samples alone."""

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.testing import assert_array_equal
from rosbags.rosbag2 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

from tam_calibration.cli.main import main
from tam_calibration.correction.streaming import PartialCorrection
from tam_calibration.files.text_files import read_text
from tam_calibration.fit import calibrate
from tam_calibration.model.exceptions import Refused
from tam_calibration.recordings.fit_input import read_source
from tam_calibration.results import read_calibration, write_calibration, write_recording

STORE = get_typestore(Stores.ROS2_JAZZY)
DIES, RETURNS = 100, 550
FIRST_WITHOUT = DIES - 1 + 200 + 1
"""The first sample more than two seconds after the sensor's last reading."""


def write_bag(folder, recording, dead):
    """Write a bag without the messages of some sensors for a part of the time."""
    write_recording(folder / "plain", recording)
    begin, end = recording.time_s[[DIES, RETURNS]] - 1e-4
    with Reader(folder / "plain") as reader, Writer(folder / "bag", version=9) as writer:
        copies = {c.topic: writer.add_connection(c.topic, c.msgtype, typestore=STORE) for c in reader.connections}
        for connection, time, raw in reader.messages():
            is_dead = any(connection.topic.startswith(f"/tam_{sensor}/") for sensor in dead)
            if not (is_dead and begin <= time / 1e9 < end):
                writer.write(copies[connection.topic], time, raw)
    return folder / "bag"


@pytest.fixture(scope="module")
def calibration(recording, cross):
    """Return the calibration of the recording."""
    return calibrate(recording, cross)


def run(*arguments):
    """Run the command and return its output."""
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.parametrize("dead", [(1,), (2, 4)], ids=str)
def test_correct_goes_on_and_says_with_what(tmp_path, recording, calibration, dead):
    """The others' outputs stand at their stamps with their errors; whole samples keep every bit."""
    write_calibration(tmp_path / "calibration.yaml", calibration)
    bag = write_bag(tmp_path, recording, dead)
    told = run("correct", bag, "--calibration", tmp_path / "calibration.yaml", "-o", tmp_path / "out")
    names = " and ".join(map(str, dead))
    count = RETURNS - FIRST_WITHOUT
    assert f"{600 - FIRST_WITHOUT + DIES} samples corrected, {count} of them without sensor {names}" in told
    whole = np.r_[:DIES, RETURNS:600]
    with Reader(tmp_path / "out") as reader:
        by_topic = {}
        for connection, _, raw in reader.messages():
            by_topic.setdefault(connection.topic, []).append(STORE.deserialize_cdr(raw, connection.msgtype))
    rows = np.array([cloud.data.view("<f8") for cloud in by_topic["/field_gradient"]])
    assert len(rows) == len(whole) + count == len(by_topic["/center"]) == len(by_topic["/gradient"])
    calibration = read_calibration(tmp_path / "calibration.yaml")
    expected = calibration.apply(recording.readings_T)
    assert_array_equal(np.r_[rows[:DIES, :9], rows[-50:, :9]], expected[whole])
    part = PartialCorrection(calibration).without(sum(1 << sensor - 1 for sensor in dead))
    without = rows[DIES:-50]
    assert_array_equal(without[:, 9:], np.broadcast_to(part.standard_errors, without[:, 9:].shape))
    known = part.is_determined
    assert np.isnan(without[:, :9][:, ~known]).all()
    assert np.abs((without[:, :9] - expected[FIRST_WITHOUT:RETURNS])[:, known] / part.standard_errors[known]).max() < 6
    center = by_topic["/center"][DIES]
    assert_array_equal(center.magnetic_field_covariance.reshape(3, 3), part.covariance[:3, :3])
    seconds = [cloud.header.stamp.sec + 1e-9 * cloud.header.stamp.nanosec for cloud in by_topic["/field_gradient"]]
    assert seconds == pytest.approx(recording.time_s[np.r_[:DIES, FIRST_WITHOUT:600]], abs=1e-6)


def test_fits_use_whole_samples_and_say_so(tmp_path, recording):
    """Where they are too few for an answer it names the sensor."""
    whole, usage = read_source(write_bag(tmp_path, recording, (3,)))
    assert_array_equal(whole.readings_T, recording.readings_T[np.r_[:DIES, RETURNS:600]])
    with pytest.raises(Refused, match="only 150 of 600 samples of sensor 1 used: 450 found none of tam_3"):
        usage.require_enough()


def test_a_table_has_nan_where_nothing_is_determined(tmp_path, recording, calibration):
    """In CSV as in bags."""
    write_calibration(tmp_path / "calibration.yaml", calibration)
    bag = write_bag(tmp_path, recording, (2, 4))
    run("correct", bag, "--calibration", tmp_path / "calibration.yaml", "-o", tmp_path / "out.csv")
    rows = [line.split(",") for line in read_text(tmp_path / "out.csv").splitlines()[1:]]
    assert rows[DIES][7:] == ["nan"] * 3 and "nan" not in rows[DIES][:7]
