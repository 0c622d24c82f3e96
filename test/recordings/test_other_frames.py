"""Messages of another frame than the array file states are told off line as on line."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.messages.point_cloud import MAGNETIC_FIELD, sensor_topic
from tam_calibration.model.mounting import Mounting
from tam_calibration.recordings.bag_writing import TYPESTORE, write_bag
from tam_calibration.recordings.recording_file import read_samples


def write_framed(path, recording, frames):
    """Write a bag whose messages name frames."""
    types = TYPESTORE.types
    with write_bag(path, "mcap") as writer:
        for sensor, frame in enumerate(frames):
            connection = writer.add_connection(f"/{sensor_topic(sensor + 1)}", MAGNETIC_FIELD, typestore=TYPESTORE)
            for time_s, reading in zip(recording.time_s, recording.readings_T[:, sensor], strict=True):
                stamp_ns = round(time_s * 1e9)
                time = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
                field = types["geometry_msgs/msg/Vector3"](*reading)
                message = types[MAGNETIC_FIELD](types["std_msgs/msg/Header"](time, frame), field, np.zeros(9))
                writer.write(connection, stamp_ns, TYPESTORE.serialize_cdr(message, MAGNETIC_FIELD))


@pytest.mark.parametrize(("frames", "told"), [("abcd", 0), ("bacd", 2)])
def test_exchanged_frames_are_a_warning(tmp_path, recording, cross, frames, told):
    """The stream, the frame that was found and the one that is stated are named, with what to do."""
    write_framed(tmp_path / "run", recording.take(slice(0, 50)), frames)
    framed = replace(cross, mounting=Mounting(frame_ids=("a", "b", "c", "d")))
    warnings = read_samples(tmp_path / "run", framed).usage.warnings()
    assert len(warnings) == told
    if told:
        assert warnings[0] == (
            "the messages of tam_1 are of the frame b, the array file says a: name the topics in a map, or correct "
            "frame_ids"
        )
