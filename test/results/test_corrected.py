"""Corrected data: as CSV, and as the corrector's topics beside everything that was in the bag."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rosbags.rosbag2 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

from tam_calibration.correction.parts import Corrected
from tam_calibration.model.array import OUTPUT_NAMES
from tam_calibration.model.recording import Recording
from tam_calibration.results import write_corrected_pieces, write_recording

STORE = get_typestore(Stores.ROS2_JAZZY)
SAMPLES = 12
STAMPS_NS = 1_700_000_000_000_000_001 + np.arange(SAMPLES) * 10_000_000


def write_corrected(path, corrected, stamps_ns=None, source=None):
    """Write all in one piece."""
    write_corrected_pieces(path, [(corrected, stamps_ns)], source)


@pytest.fixture
def corrected():
    """Return results whose numbers are all different."""
    outputs = np.random.default_rng(5).normal(size=(SAMPLES, 9)) * 1e-5
    return Corrected(np.array([stamp / 10**9 for stamp in STAMPS_NS.tolist()]), outputs, np.arange(1, 10) * 1e-10)


@pytest.fixture
def source(tmp_path):
    """Return a bag of a camera, an older result and four sensors, the stamps exact to the nanosecond."""
    path = tmp_path / "source"
    write_recording(tmp_path / "plain", Recording(np.arange(SAMPLES) / 100, np.full((SAMPLES, 4, 3), 3e-5)))
    with Reader(tmp_path / "plain") as reader, Writer(path, version=9) as writer:
        copies = {
            c.topic: writer.add_connection(f"/auv{c.topic}", c.msgtype, typestore=STORE) for c in reader.connections
        }
        camera = writer.add_connection("/camera", "std_msgs/msg/String", typestore=STORE)
        old = writer.add_connection("/auv/center", "sensor_msgs/msg/MagneticField", typestore=STORE)
        for connection, time, message in reader.messages():
            stamp = int(STAMPS_NS[time // 10_000_000])
            stamped = bytearray(message)
            stamped[4:12] = np.array([stamp // 10**9, stamp % 10**9], "<i4").tobytes()
            writer.write(copies[connection.topic], stamp + 777, bytes(stamped))
            if connection.topic == "/tam_1/magnetic_field":
                text = STORE.types["std_msgs/msg/String"](f"picture {stamp}")
                writer.write(camera, stamp + 1, STORE.serialize_cdr(text, "std_msgs/msg/String"))
                writer.write(old, stamp + 2, bytes(stamped))
    return path


def read(path):
    """Return the messages of a bag by topic: (time of recording, bytes, message)."""
    topics = {}
    with Reader(path) as reader:
        for connection, time, raw in reader.messages():
            message = STORE.deserialize_cdr(raw, connection.msgtype)
            topics.setdefault(connection.topic, []).append((time, bytes(raw), message))
    return topics


def stamp_ns(message):
    """Return the stamp of a message."""
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def check_results(topics, namespace, corrected):
    """Check the three topics against the results."""
    centers, gradients, clouds = (topics[namespace + name] for name in ("center", "gradient", "field_gradient"))
    for index, outputs in enumerate(corrected.outputs):
        center, gradient, cloud = centers[index][2], gradients[index][2], clouds[index][2]
        assert stamp_ns(center) == stamp_ns(cloud) == STAMPS_NS[index]
        assert center.header.frame_id == cloud.header.frame_id == "tam_array"
        assert [center.magnetic_field.x, center.magnetic_field.y, center.magnetic_field.z] == outputs[:3].tolist()
        covariance = center.magnetic_field_covariance.reshape(3, 3)
        assert_allclose(covariance, np.diag(corrected.standard_errors[:3] ** 2))
        bxx, bxy, bxz, byy, byz, bzz = outputs[3:]
        assert gradient.data.tolist() == [bxx, bxy, bxz, bxy, byy, byz, bxz, byz, bzz]
        assert [(each.label, each.size, each.stride) for each in gradient.layout.dim] == [
            ("row", 3, 9),
            ("column", 3, 3),
        ]
        assert [each.name for each in cloud.fields[:9]] == list(OUTPUT_NAMES)
        assert [each.offset for each in cloud.fields] == list(range(0, 144, 8))
        assert cloud.data.view("<f8").tolist() == [*outputs, *corrected.standard_errors]
        assert (cloud.height, cloud.width, cloud.point_step, cloud.row_step) == (1, 1, 144, 144)


@pytest.mark.parametrize("name", ["out", "out.mcap"])
def test_a_bag_keeps_its_other_topics(tmp_path, source, corrected, name):
    """Other topics are carried over byte for byte, older results replaced, and stamps exact."""
    write_corrected(tmp_path / name, corrected, STAMPS_NS, source)
    before, after = read(source), read(tmp_path / name)
    check_results(after, "/auv/", corrected)
    assert {topic for topic in before if topic != "/auv/center"} == set(after) - {f"/auv/{t}" for t in RESULTS}
    for topic in before:
        if topic != "/auv/center":
            assert [each[:2] for each in after[topic]] == [each[:2] for each in before[topic]]
    times = [time for time, _, _ in after["/auv/center"]]
    assert times == [time for time, _, _ in after["/auv/tam_1/magnetic_field"]]


RESULTS = ("center", "gradient", "field_gradient")


def test_only_samples_that_were_joined_get_results(tmp_path, source, corrected):
    """Readings of sensor 1 without partners have no result behind them."""
    kept = [0, 3, 11]
    some = Corrected(corrected.time_s[kept], corrected.outputs[kept], corrected.standard_errors)
    write_corrected(tmp_path / "out", some, STAMPS_NS[kept], source)
    topics = read(tmp_path / "out")
    assert [stamp_ns(message) for _, _, message in topics["/auv/center"]] == STAMPS_NS[kept].tolist()


def test_a_bag_from_csv_holds_the_results_alone(tmp_path, corrected):
    """Without a bag to carry over there are the three topics, stamped from the times."""
    write_corrected(tmp_path / "out", corrected, STAMPS_NS)
    topics = read(tmp_path / "out")
    assert set(topics) == {"/center", "/gradient", "/field_gradient"}
    check_results(topics, "/", corrected)
    write_corrected(tmp_path / "again", corrected)
    for _, _, message in read(tmp_path / "again")["/center"]:
        assert np.abs(STAMPS_NS - stamp_ns(message)).min() <= 120  # half the spacing of doubles there


def test_without_gradient_there_is_no_gradient_topic(tmp_path, corrected):
    """An array that determines no gradient publishes none; the cloud holds NaN."""
    outputs = corrected.outputs.copy()
    outputs[:, 3:] = np.nan
    write_corrected(tmp_path / "out", Corrected(corrected.time_s, outputs, corrected.standard_errors), STAMPS_NS)
    topics = read(tmp_path / "out")
    assert set(topics) == {"/center", "/field_gradient"}
    assert np.isnan(topics["/field_gradient"][0][2].data.view("<f8")[3:9]).all()


def test_csv_has_nanotesla(tmp_path, corrected):
    """The columns are those of the design, in nT and nT/m, and read back."""
    write_corrected(tmp_path / "out.csv", corrected)
    header = (tmp_path / "out.csv").read_text().splitlines()[0]
    assert header == (
        "time_s,bx_nT,by_nT,bz_nT,gxx_nT_per_m,gxy_nT_per_m,gxz_nT_per_m,gyy_nT_per_m,gyz_nT_per_m,gzz_nT_per_m"
    )
    table = np.loadtxt(tmp_path / "out.csv", delimiter=",", skiprows=1)
    assert_array_equal(table[:, 0], corrected.time_s)
    assert_allclose(table[:, 1:] / 1e9, corrected.outputs, rtol=3e-16)
