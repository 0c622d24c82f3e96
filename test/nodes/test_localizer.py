"""The localizer: a process over DDS that answers every sample as offline; and how outputs find their attitude."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.correction.streaming import PartialCorrection
from tam_calibration.fit import calibrate
from tam_calibration.localization.solutions import Status, pose_rows
from tam_calibration.localization.turned_samples import Samples, locate_samples, regional_of, turned
from tam_calibration.messages.point_cloud import FIELD_GRADIENT_COLUMNS, SOURCE_COLUMNS, SampleLayout
from tam_calibration.results import read_calibration, write_calibration

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")
visualization_msgs = pytest.importorskip("visualization_msgs.msg", reason="the ROS message packages are not installed")
geometry_msgs = pytest.importorskip("geometry_msgs.msg", reason="the ROS message packages are not installed")

FIRST = 60
"""Samples far from the source."""
STATUS = SOURCE_COLUMNS.index("status")
LAYOUT = SampleLayout(4, ("attitude",))


@pytest.fixture(scope="module")
def calibration_file(recording, cross, tmp_path_factory):
    """Return the path of the calibration of the array that passes the source."""
    path = tmp_path_factory.mktemp("calibration") / "calibration.yaml"
    write_calibration(path, calibrate(recording, cross))
    return path


@pytest.fixture(scope="module")
def near(passing):
    """Return samples of the pass far from the source, and then those next to it."""
    part = passing.take(np.r_[0:FIRST, 330:430])
    return replace(part, time_s=passing.time_s[: part.sample_count])


@pytest.fixture(scope="module")
def outputs(near, calibration_file):
    """Return field and gradient of the samples, with their standard errors."""
    corrected = read_calibration(calibration_file).correct(near)
    return np.hstack([corrected.outputs, np.tile(corrected.standard_errors, (near.sample_count, 1))])


def header(stamp_ns):
    """Return the header of a sample."""
    from rclpy.time import Time
    from std_msgs.msg import Header

    return Header(stamp=Time(nanoseconds=stamp_ns).to_msg(), frame_id="tam_array")


def stamps(recording):
    """Return the stamps of samples, nanoseconds."""
    return [round(time * 1e9) for time in recording.time_s]


class Feed:
    """Publishes what collector and corrector would, and keeps what the localizer answers."""

    def __init__(self, bench, **parameters):
        from tam_calibration.nodes.topics import RELIABLE_STREAM

        bench.start_nodes(localizer=parameters)
        self.bench = bench
        self.estimates = bench.listen(sensor_msgs.PointCloud2, "source_estimate")
        self.sources = bench.listen(geometry_msgs.PointStamped, "source")
        self.poses = bench.listen(geometry_msgs.PoseWithCovarianceStamped, "source_pose")
        self.markers = bench.listen(visualization_msgs.MarkerArray, "source_markers")
        topics = ("samples", "field_gradient") if parameters.get("regional") != "none" else ("field_gradient",)
        self.publishers = {
            topic: bench.node.create_publisher(sensor_msgs.PointCloud2, topic, RELIABLE_STREAM) for topic in topics
        }
        wanted = {f"publishers./{topic}": "1" for topic in topics}
        topics = ("source", "source_estimate", "source_pose", "source_markers")
        wanted |= {f"subscribers./{topic}": "1" for topic in topics}
        bench.health("localizer", lambda _, figures: wanted.items() <= figures.items(), "all are connected")

    def publish(self, topic, stamp_ns, columns, row):
        """Publish a row."""
        from tam_calibration.nodes.topics import make_cloud

        self.publishers[topic].publish(make_cloud(header(stamp_ns), columns, row.tolist()))

    def play(self, recording, outputs):
        """Publish samples and their outputs, no faster than they are answered; return the rows of the answers."""
        before = len(self.estimates)
        for index, (stamp, sample) in enumerate(zip(stamps(recording), LAYOUT.rows(recording), strict=True)):
            if "samples" in self.publishers:
                self.publish("samples", stamp, LAYOUT.columns, sample)
            self.publish("field_gradient", stamp, FIELD_GRADIENT_COLUMNS, outputs[index])
            self.bench.spin_until(lambda index=index: len(self.estimates) >= before + index - 20, "answers")
        self.bench.spin_until(lambda: len(self.estimates) == before + len(outputs), "every sample is answered")
        return self.rows()[before:]

    def rows(self):
        """Return the rows that were answered."""
        from tam_calibration.nodes.topics import read_cloud

        return np.concatenate([read_cloud(cloud)[1] for cloud in self.estimates])


def stamp_of(message):
    """Return the stamp of a message, nanoseconds."""
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def numbers_of(pose):
    """Return the 43 numbers of a pose with covariance."""
    place, turn = pose.pose.position, pose.pose.orientation
    return [place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w, *pose.covariance]


def rows_of(solutions):
    """Return solutions as rows of `source_estimate`."""
    from tam_calibration.nodes.localizer_node import source_rows

    return source_rows(solutions)


def test_each_sample_is_located_as_offline(bench, near, outputs, calibration_file):
    """In a fixed frame, with the regional field fitted: every sample has its answer, equal to one call for all."""
    settings = {"regional_samples": FIRST, "attitude_noise_rad": 1e-4, "fixed_frame": "level"}
    feed = Feed(bench, calibration_file=calibration_file, **settings)
    rows = feed.play(near, outputs)
    calibration = read_calibration(calibration_file)
    regional = regional_of(outputs[:FIRST, :9], near.attitude[:FIRST], 1e-4)
    assert (rows[:FIRST, STATUS] == Status.NO_REGIONAL).all()
    offline = turned(
        locate_samples(
            Samples(outputs[FIRST:, :9], calibration.array, calibration.output_covariance, near.attitude[FIRST:]),
            regional,
        ),
        near.attitude[FIRST:],
        settings["attitude_noise_rad"],
    )
    assert offline.is_located.any() and not offline.is_located.all()
    assert_allclose(rows[FIRST:], rows_of(offline), rtol=1e-12)
    feed.bench.spin_until(lambda: len(feed.sources) == offline.is_located.sum(), "only located ones are published")
    points = [[message.point.x, message.point.y, message.point.z] for message in feed.sources]
    assert_array_equal(points, rows[rows[:, STATUS] == 0, :3])
    feed.bench.spin_until(lambda: len(feed.poses) == len(points), "each has a pose")
    located = np.flatnonzero(offline.is_located)
    assert_allclose([numbers_of(message.pose) for message in feed.poses], pose_rows(offline)[located], rtol=1e-9)
    assert [stamp_of(message) for message in feed.poses] == [stamps(near)[FIRST + index] for index in located]
    of_stamp = dict(zip([stamp_of(message) for message in feed.sources], points, strict=True))
    assert feed.markers and len(feed.markers) <= len(points)
    for ball, arrow in (message.markers for message in feed.markers):
        place = ball.pose.position
        assert [place.x, place.y, place.z] == of_stamp[stamp_of(ball)] and stamp_of(arrow) == stamp_of(ball)
        assert arrow.header.frame_id == ball.header.frame_id == "level"
    assert {message.header.frame_id for message in feed.sources + feed.poses} == {"level"}
    answered = [cloud.header.stamp.sec * 10**9 + cloud.header.stamp.nanosec for cloud in feed.estimates]
    assert answered == stamps(near)
    _, figures = bench.health("localizer", lambda status, _: "located" in status.message, "it is counted")
    assert int(figures["located"]) == offline.is_located.sum()
    assert int(figures["refused.no_regional"]) == FIRST
    assert int(figures["received"]) == near.sample_count


def test_source_alone_needs_no_attitude(bench, near, outputs, calibration_file):
    """Without regional field outputs are taken as they are, in the array frame; with another index, and in batches."""
    feed = Feed(bench, regional="none", index=2.0, batch_s=0.1, calibration_file=calibration_file)
    source = outputs[:50].copy()
    source[:, :9] *= 1e-2
    source[10, 4] = np.nan
    rows = feed.play(near.take(slice(0, 50)), source)
    calibration = read_calibration(calibration_file)
    offline = locate_samples(Samples(source[:, :9], calibration.array, calibration.output_covariance, index=2.0))
    assert_allclose(rows, rows_of(offline), rtol=1e-12)
    assert rows[10, STATUS] == Status.NOT_FINITE


def test_samples_that_lack_sensors_have_the_covariance_of_the_others(bench, near, outputs, calibration_file):
    """Three sensors determine all; of two opposite ones a part of the tensor is NaN: not located, and it is said."""
    feed = Feed(bench, regional="none", calibration_file=calibration_file)
    calibration = read_calibration(calibration_file)
    partial = PartialCorrection(calibration)
    source = outputs[:40].copy()
    source[:, :9] *= 1e-2
    source[:, 9:] = partial.without(8).standard_errors
    source[20:, 9:] = partial.without(10).standard_errors
    source[20:, 6:9] = np.nan
    rows = feed.play(near.take(slice(0, 40)), source)
    offline = locate_samples(Samples(source[:20, :9], calibration.array, partial.without(8).covariance))
    assert_allclose(rows[:20], rows_of(offline), rtol=1e-9)
    assert (rows[20:, STATUS] == Status.NOT_FINITE).all()
    _, figures = bench.health("localizer", lambda _, figures: figures["received"] == "40", "all are counted")
    assert int(figures["refused.not_finite"]) == 20


def test_missing_attitude_is_answered_and_told(bench, near, outputs):
    """A sample without attitude has a status row, and /diagnostics says why nothing is located."""
    feed = Feed(bench, regional="47.4,8.5,2026-06-01")
    part = near.take(slice(0, 30))
    attitude = np.full((30, 4), np.nan)
    attitude[:5] = part.attitude[:5]
    for stamp, sample, row in zip(stamps(part), LAYOUT.rows(part), outputs, strict=False):
        sample[-4:] = attitude[stamps(part).index(stamp)]
        feed.publish("samples", stamp, LAYOUT.columns, sample)
        feed.publish("field_gradient", stamp, FIELD_GRADIENT_COLUMNS, row)
    bench.spin_until(lambda: len(feed.estimates) == 30, "every sample is answered")
    assert (feed.rows()[5:, STATUS] == Status.NO_ATTITUDE).all()
    assert (feed.rows()[:5, STATUS] != Status.NO_ATTITUDE).all()
    bench.health("localizer", lambda _, figures: figures["refused.no_attitude"] == "25", "it is counted")


def test_a_bag_that_starts_over_is_a_new_run(bench, near, outputs, calibration_file):
    """When stamps go back the regional field is fitted again, and still every sample is answered."""
    feed = Feed(bench, regional_samples=20, calibration_file=calibration_file)
    part = near.take(slice(0, 40))
    for rows in (feed.play(part, outputs[:40]), feed.play(part, outputs[:40])):
        assert (rows[:20, STATUS] == Status.NO_REGIONAL).all()
        assert (rows[20:, STATUS] != Status.NO_REGIONAL).all()


def test_a_step_of_the_clock_keeps_the_regional_field(bench, near, outputs, calibration_file):
    """Stamps that step back by less than the run, or by more, cost no sample and no new fit."""
    feed = Feed(bench, regional_samples=20, calibration_file=calibration_file)
    feed.play(near.take(slice(0, 40)), outputs[:40])
    for step_s, part in ((0.3, slice(40, 60)), (100.0, slice(60, 80))):
        later = near.take(part)
        rows = feed.play(replace(later, time_s=later.time_s - step_s), outputs[part])
        assert not np.isin(rows[:, STATUS], [Status.NO_REGIONAL, Status.NO_ATTITUDE]).any()


def test_other_columns_are_told(bench, near, outputs):
    """A cloud of other columns is an error that names those that are needed."""
    feed = Feed(bench, regional="none")
    feed.publish("field_gradient", 1, FIELD_GRADIENT_COLUMNS[:9], outputs[0, :9])
    status, _ = bench.health("localizer", lambda status, _: "columns" in status.message, "it is told")
    assert status.level == b"\x02"


def test_whole_chain_locates_the_source(bench, near, calibration_file):
    """Raw readings and an IMU: collector, corrector and localizer together find the dipole as it is passed."""
    from rclpy.time import Time

    fitted = {"calibration_file": calibration_file, "regional_samples": FIRST, "fixed_frame": "level"}
    bench.start_nodes(collector={}, corrector={"calibration_file": calibration_file}, localizer=fitted)
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    estimates = bench.listen(sensor_msgs.PointCloud2, "source_estimate")
    imu = bench.node.create_publisher(sensor_msgs.Imu, "imu/data", 1000)
    bench.spin_until(imu.get_subscription_count, "the attitude is subscribed")
    sensors = bench.publish_sensors(scalar=False)
    connected = {"collector": {"samples": 3}, "corrector": {"field_gradient": 1}, "localizer": {"source_estimate": 1}}
    bench.connect(**connected)

    def publish(recording, index):
        message = sensor_msgs.Imu()
        message.header.stamp = Time(nanoseconds=stamps(recording)[index]).to_msg()
        turn = message.orientation
        turn.x, turn.y, turn.z, turn.w = recording.attitude[index].tolist()
        imu.publish(message)
        bench.spin_until(lambda: True, "at once")
        sensors(recording, index)

    bench.play(near, publish, samples)
    bench.spin_until(lambda: len(estimates) >= near.sample_count - 1, "all are answered")
    from tam_calibration.nodes.topics import read_cloud

    rows = np.concatenate([read_cloud(cloud)[1] for cloud in estimates])
    nearest = rows[FIRST + 70]
    assert nearest[STATUS] == 0
    assert_allclose(nearest[:3], [0.0, 2.5, -2.3], atol=0.1)


def test_outputs_wait_for_their_attitude():
    """Whichever comes first, outputs get the attitude of their stamp, in order and once."""
    from tam_calibration.nodes.survey import AttitudeJoin

    join, turn, row = AttitudeJoin(), np.ones(4), np.zeros(18)
    assert join.push_outputs(1, row) == []
    assert join.push_outputs(2, row) == []
    [first] = join.push_attitude(1, turn)
    assert (first.stamp_ns, first.attitude is turn) == (1, True)
    lost, third = *join.push_attitude(3, turn), *join.push_outputs(3, row)
    assert (lost.stamp_ns, lost.attitude) == (2, None)
    assert (third.stamp_ns, third.attitude is turn) == (3, True)


def test_a_new_run_begins_without_a_loss():
    """When stamps start over, outputs that still waited go on without attitude, and new ones find theirs."""
    from tam_calibration.nodes.survey import AttitudeJoin

    join, turn, row = AttitudeJoin(), np.ones(4), np.zeros(18)
    join.push_attitude(100, turn)
    assert [one.attitude is turn for one in join.push_outputs(100, row)] == [True]
    assert join.push_outputs(101, row) == []
    assert [(one.stamp_ns, one.attitude) for one in join.push_outputs(5, row)] == [(101, None)]
    assert [(one.stamp_ns, one.attitude is turn) for one in join.push_attitude(5, turn)] == [(5, True)]
    join.push_attitude(3, turn)
    assert [(one.stamp_ns, one.attitude is turn) for one in join.push_outputs(3, row)] == [(3, True)]


def test_outputs_do_not_wait_for_ever():
    """Without any sample the oldest outputs go on without attitude."""
    from tam_calibration.nodes.survey import LONGEST_WAIT, AttitudeJoin

    join = AttitudeJoin()
    answered = [one for stamp in range(LONGEST_WAIT + 7) for one in join.push_outputs(stamp, np.zeros(18))]
    assert [one.stamp_ns for one in answered] == list(range(7))


def test_the_targets_of_the_last_stretch_are_published(bench, passing, calibration_file):
    """Positions from the odometry: one ellipsoid at the wreck, and one arrow, in the frame of the odometry.

    A gyroscope with gaps is left out, and `/diagnostics` says so.
    """
    from nav_msgs.msg import Odometry

    from tam_calibration.nodes.topics import RELIABLE_STREAM, make_cloud

    bench.start_nodes(
        localizer={"calibration_file": str(calibration_file), "targets_s": 100.0, "targets_period_s": 0.5}
    )
    shown = bench.listen(visualization_msgs.MarkerArray, "targets")
    samples = bench.node.create_publisher(sensor_msgs.PointCloud2, "samples", RELIABLE_STREAM)
    odometry = bench.node.create_publisher(Odometry, "odometry", RELIABLE_STREAM)
    wanted = {"publishers./samples": "1", "publishers./odometry": "1", "subscribers./targets": "1"}
    bench.health("localizer", lambda _, figures: wanted.items() <= figures.items(), "all are connected")
    layout, rates = SampleLayout(4, ("attitude", "gyroscope")), np.zeros((passing.sample_count, 3))
    rates[::2] = np.nan
    passing = replace(passing, angular_velocity_rad_s=rates)
    for index, (stamp, row) in enumerate(zip(stamps(passing), layout.rows(passing), strict=True)):
        if index % 10 == 0:
            message = Odometry(header=header(stamp))
            message.header.frame_id = "odom"
            message.pose.pose.position.x = 1.5 * index / 20
            odometry.publish(message)
        samples.publish(make_cloud(header(stamp), layout.columns, row.tolist()))

    def balls():
        return [each for each in (shown[-1].markers if shown else []) if each.ns == "position"]

    bench.spin_until(lambda: len(balls()) == 1, "the target is published")
    [ball], place = balls(), balls()[0].pose.position
    assert ball.header.frame_id == "odom"
    assert_allclose([place.x, place.y, place.z], [30.0, 2.5, -2.3], atol=0.3)
    bench.health("localizer", lambda _, figures: "has gaps" in figures["targets_attitude"], "the gyroscope is left out")
