"""One name, one node: who comes second ends and says why."""

import signal

import pytest
from ros_bench import own_lines

from tam_calibration.nodes.session import START

diagnostic_msgs = pytest.importorskip("diagnostic_msgs.msg", reason="the ROS message packages are not installed")


def commands_of(*names):
    """Return the commands of calibrators, by names that only the test knows."""
    return {name: [*START, "calibrator"] for name in names}


def ended(children):
    """Return the names of the processes that have ended."""
    return [name for name in children.pids if not children.is_running(name)]


def wait_for_the_end_of(bench, children, name):
    """Spin without the check that all still run, until one has ended."""
    bench.children.remove(children)
    bench.spin_until(lambda: name in ended(children), f"{name} ends")


def test_second_start_is_refused_and_the_first_goes_on(bench):
    """The second ends with exit code 2 and the number of the first, which answers as before."""
    first = bench.start_nodes(calibrator={})
    second = bench.fork(commands_of("second"))
    wait_for_the_end_of(bench, second, "second")
    assert second.end() == {"second": 2}
    sentence = f"tam: /calibrator runs already in ROS domain {bench.context.get_domain_id()}, as process "
    (said,) = own_lines(second.log("second"))
    assert said.startswith(f"{sentence}{first.pids['calibrator']}: end that one first")
    assert "no samples are stored" in bench.call("calibrator/calibrate").message


def test_of_many_that_start_at_once_one_stays(bench):
    """However close the starts are."""
    names = {"one", "two", "three"}
    children = bench.fork(commands_of(*names))
    bench.children.remove(children)
    bench.spin_until(lambda: len(ended(children)) == 2, "two have ended")
    bench.spin_until(lambda: bench.node.count_services("calibrator/save"), "the third offers its services")
    codes = children.end()
    assert sorted(codes.values()) == [0, 2, 2], codes


def test_name_of_a_node_that_was_killed_is_free_at_once(bench):
    """Nothing is left behind that a person would have to remove; and no ghost of it is taken for a twin."""
    assert bench.start_nodes(calibrator={}).end_one("calibrator", signal.SIGKILL) == -signal.SIGKILL
    bench.fork(commands_of("next"))
    status, _ = bench.health("calibrator", lambda *_: True, "the next is well")
    assert status.message == "no samples yet"


def test_another_namespace_is_another_name(bench):
    """Two arrays on a machine have a calibrator each."""
    bench.fork(commands_of("first") | {"second": [*START, "calibrator", "--ros-args", "-r", "__ns:=/auv"]})
    bench.health("calibrator", lambda *_: True, "the first is there")
    bench.health("auv/calibrator", lambda *_: True, "the second is there")


def test_a_node_of_the_same_name_on_another_machine_is_an_error(bench):
    """It cannot be refused, as it may have been first; both say so for as long as both are there."""
    import rclpy

    bench.start_nodes(calibrator={})
    twin = rclpy.create_node("calibrator", context=bench.context)
    twin.create_publisher(diagnostic_msgs.DiagnosticArray, "/diagnostics", 10)
    error = diagnostic_msgs.DiagnosticStatus.ERROR
    status, _ = bench.health("calibrator", lambda status, _: status.level == error, "the twin is told")
    assert status.message.startswith("another /calibrator runs on another machine of this ROS domain")
    twin.destroy_node()
    bench.health("calibrator", lambda status, _: status.level != error, "the twin has gone")
