"""How many of sensor 1's samples were used: the calibrator's answers over DDS, with what the collector counted."""

import re
from dataclasses import replace

import pytest

from tam_calibration.results import calibration_from_yaml

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")
std_msgs = pytest.importorskip("std_msgs.msg", reason="the ROS message packages are not installed")


@pytest.fixture
def drivers(bench):
    """Start collector and calibrator; return the samples and what publishes sensor 3 and the others."""
    bench.start_nodes(collector={}, calibrator={})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    others, third = bench.publish_sensors((1, 2, 4)), bench.publish_sensors((3,), scalar=False)
    bench.connect(collector={"samples": 2})
    return samples, others, third


def play(bench, drivers, recording, lost=0, of=20):
    """Play the recording, of which so many readings of sensor 3 in so many are lost."""
    (samples, others, third), used = drivers, 0
    for index in range(recording.sample_count):
        others(recording, index)
        if index % of >= lost:
            third(recording, index)
            used += 1
        bench.spin_until(lambda used=used: len(samples) >= used - 20, f"sample {index} comes back")
    is_heard = {"tam_1.received": "600", "tam_3.received": str(used)}.items()
    bench.health("collector", lambda _, figures: is_heard <= figures.items(), "all is received")
    bench.spin_until(lambda: len(samples) == used, "all samples come back")
    bench.health("calibrator", lambda _, figures: figures["samples"] == str(used), "all samples are stored")


def test_an_answer_tells_that_all_were_used(bench, drivers, recording):
    """Without losses there is nothing else to tell."""
    play(bench, drivers, recording)
    answer = bench.call("calibrator/calibrate")
    assert answer.success and answer.message.endswith("600 samples; 600 of 600 samples of sensor 1 used")


def test_below_nine_tenths_is_a_warning(bench, drivers, recording):
    """In the answer, and in the calibration that is handed on."""
    play(bench, drivers, recording, lost=10, of=40)
    answer = bench.call("calibrator/calibrate")
    warning = "only 450 of 600 samples of sensor 1 used: 150 found none of tam_3, of which 450 messages came"
    assert answer.success and warning in answer.message
    latched = bench.listen(std_msgs.String, "calibration", latched=True)
    bench.spin_until(lambda: latched, "the calibration is handed on")
    assert warning in calibration_from_yaml(latched[0].data, "topic").warnings[0]


@pytest.mark.parametrize("service", ["calibrate", "diagnose"])
def test_below_half_is_refused(bench, drivers, recording, service):
    """With the cause; after a reset nothing of it is left."""
    play(bench, drivers, recording, lost=12, of=20)
    answer = bench.call(f"calibrator/{service}")
    assert not answer.success
    assert "only 240 of 600 samples of sensor 1 used: 360 found none of tam_3" in answer.message
    assert bench.call("collector/reset").success
    assert '"used": 0, "received": 0' in bench.call("collector/usage").message


def test_a_clock_that_differs_names_the_parameter(bench, drivers, recording):
    """Where nothing is joined the reason is the stamps, not that no sample is stored."""
    _, others, third = drivers
    late = replace(recording, time_s=recording.time_s - 1.0)
    bench.stream(recording, [others, lambda _, index: third(late, index)])
    bench.health("collector", lambda _, figures: int(figures.get("tam_3.received", 0)) > 200, "readings have come")
    answer = bench.call("calibrator/calibrate")
    assert not answer.success and answer.message.startswith("only 0 of ")
    assert re.search(
        r"found none of tam_3, whose newest stamp is (1|1\.01|0\.99) s behind that of tam_", answer.message
    )
    assert "delay_s in the array file" in answer.message


def test_without_collector_the_usage_is_not_known(bench, recording):
    """Samples of another origin are calibrated, and the answer says what it does not know."""
    from std_msgs.msg import Header

    from tam_calibration.messages.point_cloud import SampleLayout
    from tam_calibration.messages.samples import stamps_of
    from tam_calibration.nodes.cloud import make_cloud
    from tam_calibration.nodes.listening import RELIABLE_STREAM

    bench.start_nodes(calibrator={})
    publisher = bench.node.create_publisher(sensor_msgs.PointCloud2, "samples", RELIABLE_STREAM)
    bench.health("calibrator", lambda _, figures: figures.get("publishers./samples") == "1", "it is connected")
    layout = SampleLayout.of(recording)
    for stamp_ns, row in zip(stamps_of(recording.time_s).tolist(), layout.rows(recording).tolist(), strict=True):
        cloud = make_cloud(Header(), layout.columns, row)
        cloud.header.stamp.sec, cloud.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        publisher.publish(cloud)
    bench.health("calibrator", lambda _, figures: figures["samples"] == "600", "all samples are stored")
    answer = bench.call("calibrator/calibrate")
    assert answer.success and answer.message.endswith("no collector says how many samples of sensor 1 were used")
