"""Recordings as bags: every storage reads alike, and what is wrong with a bag is one sentence."""

import logging
import shutil
from dataclasses import replace

import numpy as np
import pytest
from messages.test_synchroniser import stalled
from numpy.testing import assert_allclose, assert_array_equal
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from tam_calibration.correction.parts import Corrected
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.mounting import Mounting
from tam_calibration.model.recording import Recording
from tam_calibration.recordings import read_recording, read_samples
from tam_calibration.recordings.recording_file import read_pieces
from tam_calibration.results import write_corrected_pieces, write_recording

STORE = get_typestore(Stores.ROS2_JAZZY)
FIELD, FLOAT64, IMU = "sensor_msgs/msg/MagneticField", "std_msgs/msg/Float64", "sensor_msgs/msg/Imu"
START_NS = 1_700_000_000_123_456_789
PERIOD_NS = 10_000_000


def make(msgtype, *values):
    """Make a message of rosbags."""
    return STORE.types[msgtype](*values)


def header(stamp_ns, frame_id="sensor"):
    """Make a header."""
    time = make("builtin_interfaces/msg/Time", stamp_ns // 10**9, stamp_ns % 10**9)
    return make("std_msgs/msg/Header", time, frame_id)


def vector(x, y, z):
    """Make a vector."""
    return make("geometry_msgs/msg/Vector3", x, y, z)


def field(stamp_ns, x=3e-5, y=0.0, z=4e-5, frame_id="sensor"):
    """Make a MagneticField."""
    return make(FIELD, header(stamp_ns, frame_id), vector(x, y, z), np.zeros(9))


def write(path, messages, storage=StoragePlugin.SQLITE3, compression=None, types=()):
    """Write a bag of (topic, recorded_ns, message); types adds topics without messages."""
    writer = Writer(path, version=9, storage_plugin=storage)
    if compression:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connections = {t: writer.add_connection(t, msgtype, typestore=STORE) for t, msgtype in types}
        for topic, recorded_ns, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=STORE)
            writer.write(connections[topic], recorded_ns, STORE.serialize_cdr(message, message.__msgtype__))
    return path


def stamps(count=20):
    """Return stamps in nanoseconds."""
    return [START_NS + index * PERIOD_NS for index in range(count)]


def two_sensors(namespace="/", count=20):
    """Make the messages of two sensors and a scalar."""
    return [
        (f"{namespace}{topic}", stamp, field(stamp, frame_id=topic))
        for stamp in stamps(count)
        for topic in ("tam_1/magnetic_field", "tam_2/magnetic_field", "scalar/intensity")
    ]


def full_recording(samples=30):
    """Make a recording with all channels."""
    rng = np.random.default_rng(4)
    scalar = 50e-6 + rng.normal(size=samples) * 1e-9
    scalar[5] = np.nan
    attitude = rng.normal(size=(samples, 4))
    readings = rng.normal(size=(samples, 3, 3)) * 5e-5
    temperature, *currents = rng.normal(size=(3, samples))
    further = {"current_2_A": currents[1], "actuator_rudder": rng.normal(size=samples)}
    return Recording(np.arange(samples) / 64, readings, scalar, temperature, currents[0], attitude, further)


@pytest.mark.parametrize(("name", "storage"), [("bag", "sqlite3"), ("bag", "mcap"), ("bag.mcap", "sqlite3")])
def test_a_recording_reads_back(tmp_path, name, storage):
    """Folder and single file give the very numbers that were written, in every channel."""
    recording = full_recording()
    write_recording(tmp_path / name, recording, storage)
    again = read_recording(tmp_path / name)
    assert list(again.values()) == list(recording.values())
    for name, values in recording.values().items():
        assert_array_equal(again.values()[name], values)


@pytest.mark.parametrize("name", ["a#b", "a?b=c", "50%20 of x", "%41", "file:x", "ä\u2028 "])
@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_a_bag_may_have_any_name(tmp_path, name, storage):
    """Also what means something else where names stand in URIs, as SQLite has them; nothing is written elsewhere."""
    recording = full_recording()
    write_recording(tmp_path / name, recording, storage)
    assert {each.name for each in tmp_path.iterdir()} == {name}
    assert_array_equal(read_recording(tmp_path / name).readings_T, recording.readings_T)


@pytest.mark.parametrize("storage", StoragePlugin)
@pytest.mark.parametrize("compression", [None, *CompressionMode][:4])
def test_every_storage_and_compression_reads_alike(tmp_path, storage, compression):
    """sqlite3 and mcap, plain and with zstd by file, message and chunk."""
    samples = read_samples(write(tmp_path / "bag", two_sensors(), storage, compression))
    assert samples.stamps_ns.tolist() == stamps()
    assert_array_equal(samples.recording.time_s, [stamp / 10**9 for stamp in stamps()])
    assert_allclose(samples.recording.scalar_T, 5e-5)
    assert samples.recording.readings_T[7].tolist() == [[3e-5, 0, 4e-5]] * 2


def test_topics_may_stand_under_a_namespace(tmp_path):
    """The topics are found by the end of their names."""
    assert read_recording(write(tmp_path / "bag", two_sensors("/auv/"))).scalar_T is not None


def test_stamps_join_the_topics_not_the_times_of_recording(tmp_path):
    """Messages that were recorded late and in bursts are joined by their stamps."""
    messages = sorted(two_sensors(), key=lambda one: (one[1] // 10**8, one[0]))
    samples = read_samples(write(tmp_path / "bag", [(topic, 5, message) for topic, _, message in messages]))
    assert samples.stamps_ns.tolist() == stamps()


def test_a_scalar_without_stamps_is_held(tmp_path):
    """std_msgs/Float64 gives each sample the value that was recorded last."""
    messages = []
    for index, stamp in enumerate(stamps()):
        messages.append(("/tam_1/magnetic_field", stamp, field(stamp)))
        messages.append(("/scalar/intensity", stamp, make(FLOAT64, 5e-5 + index * 1e-9)))
    scalar = read_recording(write(tmp_path / "bag", messages)).scalar_T
    assert_allclose(scalar, 5e-5 + np.arange(20) * 1e-9)


def test_an_imu_without_orientation_gives_none(tmp_path):
    """An IMU whose covariance says that it has no orientation is no attitude."""
    none = np.array([-1.0, *[0.0] * 8])
    still = vector(0.0, 0.0, 0.0)
    quaternion = make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
    imu = [("/imu/data", s, make(IMU, header(s), quaternion, none, still, none, still, none)) for s in stamps()]
    messages = sorted([*two_sensors(), *imu], key=lambda one: one[1])
    assert read_recording(write(tmp_path / "bag", messages)).attitude is None


def test_losses_are_said(tmp_path, caplog):
    """A sample of which a sensor's messages tell nothing is left out, and counted."""
    messages = two_sensors()
    assert "tam_2" in messages[1][0]
    del messages[1]
    with caplog.at_level(logging.WARNING):
        assert read_recording(write(tmp_path / "bag", messages)).sample_count == 19
    assert "19 of 20 samples synchronised" in caplog.text
    assert "tam_2: missing in 1 samples" in caplog.text


def test_sensors_that_are_read_one_after_the_other_are_interpolated(tmp_path):
    """All samples but the first four, before which too little was read; within a tolerance they stay as they are."""
    apart = [(t, s, field(s + 3_000_000 * ("tam_2" in t))) for t, s, _ in two_sensors()]
    path = write(tmp_path / "bag", apart)
    assert read_recording(path).sample_count == 16
    assert read_recording(path, tolerance_s=4e-3).sample_count == 20


def test_a_first_sensor_that_is_read_more_often_makes_a_sample_of_each_reading(tmp_path):
    """Its messages are more than those of the bag over the number of sensors."""
    messages = enumerate(two_sensors(count=40))
    halved = [one for index, one in messages if "tam_1" in one[0] or ("tam_2" in one[0] and index % 2)]
    assert len(halved) == 60
    assert read_recording(write(tmp_path / "bag", halved)).sample_count == 36


@pytest.mark.parametrize("storage", StoragePlugin)
def test_progress_is_told(tmp_path, storage):
    """The callback counts the bytes of the bag's file, and ends with everything done."""
    told = []
    path = write(tmp_path / "bag", two_sensors(count=9000), storage)
    read_samples(path, progress=lambda done, total: told.append((done, total)))
    size = next(path.glob("bag.*")).stat().st_size
    assert len(told) > 2 and told[-1] == (size, size)
    assert told == sorted(told) and 0 < told[0][0] < size


def refuse(path, sentence, **options):
    """Check that a bag is refused with one sentence that names it."""
    with pytest.raises(InputError, match=sentence) as problem:
        read_recording(path, **options)
    assert str(path) in str(problem.value)
    assert "\n" not in str(problem.value)


@pytest.mark.parametrize(
    ("storage", "compression", "suffix"),
    [
        (StoragePlugin.SQLITE3, None, "db3"),
        (StoragePlugin.MCAP, None, "mcap"),
        (StoragePlugin.SQLITE3, CompressionMode.FILE, "zstd"),
    ],
)
def test_bags_without_content_are_refused(tmp_path, storage, compression, suffix):
    """A data file of which nothing is left is damage; what is left of others is in ``test_bag_recovery``."""
    path = write(tmp_path / "bag", two_sensors(count=200), storage, compression)
    next(path.glob(f"*.{suffix}")).write_bytes(b"")
    refuse(path, "is damaged or truncated: ")


def test_a_bag_without_messages_is_refused(tmp_path):
    """A recorder that was killed leaves topics without messages."""
    refuse(write(tmp_path / "bag", [], types=[("/tam_1/magnetic_field", FIELD)]), "contains no message")


def test_damaged_messages_are_refused(tmp_path):
    """A message that is too short is told with its topic."""
    path = tmp_path / "bag"
    with Writer(path, version=9) as writer:
        connection = writer.add_connection("/tam_1/magnetic_field", FIELD, typestore=STORE)
        writer.write(connection, 1, b"\x00\x01\x00\x00\x01")
    refuse(path, "topic /tam_1/magnetic_field: a message is damaged")


def test_missing_and_mistyped_topics_are_named(tmp_path):
    """The topic is named, and what there is is listed."""
    scalar_only = [one for one in two_sensors() if one[0] == "/scalar/intensity"]
    refuse(
        write(tmp_path / "a", scalar_only),
        "no vector of a magnetic field is recognised among /scalar/intensity .*; `tam inspect",
    )
    without_2 = [*two_sensors(), *((f"/tam_4{t[6:]}", s, m) for t, s, m in two_sensors() if "tam_1" in t)]
    refuse(
        write(tmp_path / "b", without_2),
        "topic /tam_3/magnetic_field is missing; the recording has .*/tam_4/magnetic_field",
    )
    refuse(write(tmp_path / "c", two_sensors()), "topic /tam_3/magnetic_field is missing", sensor_count=4)
    refuse(tmp_path / "c", "the bag has 2 sensors, the array 1", sensor_count=1)
    wrong = [("/tam_1/magnetic_field", 1, make(FLOAT64, 1.0))]
    refuse(
        write(tmp_path / "d", wrong),
        "/tam_1/magnetic_field has the type std_msgs/msg/Float64, and the map does not say",
    )
    wrong = [*two_sensors(count=5), ("/temperature", START_NS, field(START_NS))]
    refuse(write(tmp_path / "e", wrong), "/temperature has the type sensor_msgs/msg/MagneticField, and the map does")
    several = [*two_sensors("/a/"), *two_sensors("/b/")]
    refuse(write(tmp_path / "f", several), "several arrays, under /a/, /b/")


def test_topics_that_cannot_be_joined_are_explained(tmp_path):
    """When no stamps fit, or a sensor is silent, the reason is given."""
    apart = [(t, s, field(s + 3_000_000_000 * ("tam_2" in t))) for t, s, _ in two_sensors()]
    refuse(write(tmp_path / "a", apart), "no sample could be joined .*tam_2: missing in 20 samples.* one clock")
    silent = [one for one in two_sensors() if "tam_2" not in one[0]]
    path = write(tmp_path / "b", silent, types=[("/tam_2/magnetic_field", FIELD)])
    refuse(path, "no sample could be joined .*nothing arrived from tam_2")


@pytest.mark.parametrize("sensor", [1, 2])
def test_a_sensor_without_stamps_has_the_times_of_the_recorder(tmp_path, sensor, caplog):
    """So have the others then, as one clock must tell all times; a warning says so, and how even they are."""
    messages = [
        (f"/tam_{k}/magnetic_field", stamp_ns, field(0 if k == sensor else stamp_ns))
        for stamp_ns in stamps()
        for k in (1, 2)
    ]
    path = write(tmp_path / "bag", messages)
    assert read_recording(path).sample_count == len(stamps())
    assert "the recorder's times are taken; their intervals vary by" in caplog.text


def test_a_bag_of_several_rounds_is_refused(tmp_path):
    """Stamps that go back are several runs, which one recording cannot hold."""
    round_ = two_sensors(count=700)
    again = [(topic, recorded + 7 * 10**9, message) for topic, recorded, message in round_]
    refuse(write(tmp_path / "bag", [*round_, *again]), "the stamps go backwards: keep one run")


@pytest.mark.parametrize("step_ns", [-300_000_000, -20_000_000_000, 500_000_000])
def test_a_step_of_the_clock_keeps_the_run(tmp_path, caplog, step_ns):
    """All samples are read; where the stamps step back time goes on, and the step is said with its size."""
    messages = [
        (topic, recorded, field(recorded + step_ns * (index >= 150), x=1e-9 * index))
        for index, recorded in enumerate(stamps(300))
        for topic in ("/tam_1/magnetic_field", "/tam_2/magnetic_field")
    ]
    path = write(tmp_path / "bag", messages)
    with caplog.at_level(logging.WARNING):
        samples = read_samples(path)
    expected = [stamp + step_ns * (index >= 150) for index, stamp in enumerate(stamps(300))]
    assert samples.stamps_ns.tolist() == expected
    assert_allclose(samples.recording.readings_T[:, 1, 0], 1e-9 * np.arange(300))
    times = stamps(300) if step_ns < 0 else expected
    assert_array_equal(samples.recording.time_s, [time / 10**9 for time in times])
    direction = "back" if step_ns < 0 else "ahead"
    assert f"the stamps of tam_1 stepped {direction} by {abs(step_ns) / 1e9:g} s" in caplog.text
    assert len(caplog.records) == 1
    pieces = [piece.recording.time_s for piece in read_pieces(path)]
    assert_array_equal(np.concatenate(pieces), samples.recording.time_s)


def test_results_of_stamps_that_step_back_are_no_bag(tmp_path):
    """Each result stands behind its reading, which its stamp tells: the way out is named."""
    corrected = Corrected(np.arange(3.0), np.zeros((3, 9)), np.zeros(9))
    with pytest.raises(InputError, match=r"stamps of the samples step back: write a \.csv"):
        write_corrected_pieces(tmp_path / "out.mcap", [(corrected, np.array([5, 6, 4]))])


def test_a_bad_message_costs_one_sample(tmp_path, caplog):
    """A false stamp, one that is no time, and values that are not finite; an infinite attitude costs none."""
    none, still = np.zeros(9), vector(0.0, 0.0, 0.0)
    messages = []
    for index, recorded in enumerate(stamps(300)):
        turn = make("geometry_msgs/msg/Quaternion", np.inf if index == 7 else 0.0, 0.0, 0.0, 1.0)
        messages.append(("/imu/data", recorded, make(IMU, header(recorded), turn, none, still, none, still, none)))
        for name in ("tam_1", "tam_2"):
            false = {20: 0, 40: recorded + 10**16, 60: recorded - 10**9, 80: -(10**9)}
            stamp = false.get(index, recorded) if name == "tam_1" or index < 30 else recorded
            x = {100: np.nan, 120: np.inf}.get(index, 3e-5)
            messages.append((f"/{name}/magnetic_field", recorded, field(stamp, x=x)))
    with caplog.at_level(logging.WARNING):
        samples = read_samples(write(tmp_path / "bag", messages))
    lost = (20, 40, 60, 80, 100, 120)
    assert samples.stamps_ns.tolist() == [stamp for index, stamp in enumerate(stamps(300)) if index not in lost]
    assert "294 of 300 samples synchronised; tam_1: 3 stamps far from those before and after, 3 messages" in caplog.text
    assert "attitude: 1 messages unusable" in caplog.text and "stepped" not in caplog.text


def test_times_that_are_no_stamps_are_refused(tmp_path):
    """Before 1970 there is no stamp; nothing is written."""
    with pytest.raises(InputError, match="cannot be stamps of messages"):
        write_recording(tmp_path / "bag", Recording(np.array([-1.0, 0.0]), np.ones((2, 1, 3))))
    assert not any(tmp_path.iterdir())


def test_a_bag_is_known_by_its_content(tmp_path):
    """A single file of a bag is read whatever its suffix."""
    path = write(tmp_path / "bag", two_sensors(), StoragePlugin.MCAP)
    shutil.copy(path / "bag.mcap", tmp_path / "alone.mcap")
    assert read_recording(tmp_path / "alone.mcap").sample_count == 20
    with Reader(tmp_path / "alone.mcap") as reader:
        assert reader.message_count == 60


@pytest.mark.parametrize("name", ["bag", "run.csv"])
def test_what_the_drivers_recorded_comes_into_the_axes_of_the_array(tmp_path, name):
    """By the array of the file, from bag and CSV; whole and in pieces; without rotations to the last bit as it is."""
    recording = full_recording()
    rng = np.random.default_rng(8)
    mounting = Mounting(Rotation.random(3, rng=rng).as_quat(), Rotation.random(rng=rng).as_quat())
    array = Array(np.eye(3), mounting=mounting)
    write_recording(tmp_path / name, recording)
    plain, expected = read_recording(tmp_path / name), mounting.turned(recording)
    for read in (
        read_recording(tmp_path / name, array=array),
        *(piece.recording for piece in read_pieces(tmp_path / name, array=array)),
    ):
        assert_array_equal(read.readings_T, mounting.turned(plain).readings_T)
        assert_allclose(read.readings_T, expected.readings_T, rtol=1e-12)
        assert_allclose(read.attitude, expected.attitude, rtol=1e-12)
    unturned = read_recording(tmp_path / name, array=replace(array, mounting=Mounting()))
    assert list(unturned.values()) == list(plain.values())
    for name, values in plain.values().items():
        assert_array_equal(unturned.values()[name], values)


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize("chunk", [1, 256, 2000])
def test_what_a_recorder_got_in_a_burst_is_joined(tmp_path, storage, chunk):
    """A recorder that stood still for four seconds wrote one stream after another: every sample is there."""
    topics = {f"tam_{sensor}": f"/tam_{sensor}/magnetic_field" for sensor in (1, 2, 3)} | {
        "scalar": "/scalar/intensity"
    }
    messages = [
        (topics[name], arrived_ns, field(stamp_ns, x=1e-5 * (stamp_ns % 10**9) / 1e9))
        for name, stamp_ns, _, arrived_ns in stalled([*topics], 100, 500, chunk, 100_000_000)
    ]
    samples = read_samples(write(tmp_path / "bag", messages, storage))
    assert samples.recording.sample_count == 800 and (samples.usage.used, samples.usage.received) == (800, 800)
    assert np.isfinite(samples.recording.scalar_T).all()
    assert_array_equal(samples.recording.readings_T[:, 0], samples.recording.readings_T[:, 2])
