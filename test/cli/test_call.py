"""`tam call`: services of the nodes from the command line."""

import os
import subprocess
import sys

import pytest
from click.testing import CliRunner

from tam_calibration.cli.main import main
from tam_calibration.files.text_files import configuration_folder

pytest.importorskip("rclpy", reason="rclpy is not installed: pip install 'tam_calibration[ros]'")


def call(service):
    """Run the command."""
    return CliRunner().invoke(main, ["call", service])


def test_an_answer_is_printed_and_its_exit_code_says_whether_it_is_yes(bench):
    """The collector's reset answers yes, a calibrator without samples no, and says why."""
    bench.start_nodes(collector={}, calibrator={})
    done = call("collector/reset")
    assert done.exit_code == 0, done.stderr
    assert done.stdout.strip()
    done = call("calibrator/calibrate")
    assert done.exit_code == 1
    assert done.stderr.startswith("tam: calibrator/calibrate: no samples are stored")


@pytest.mark.parametrize("service", ["", "bad name!", "calibrator/", "1st"])
def test_what_is_no_name_is_bad_input(service):
    """It is told in one sentence."""
    done = call(service)
    assert done.exit_code == 2
    assert done.stderr == f"tam: {service!r} is no name of a service: give one such as calibrator/calibrate\n"


def test_a_service_that_nobody_offers_is_told(ros_domain):
    """Without nodes the answer names the service and what to start."""
    done = call("calibrator/save")
    assert done.exit_code == 1
    assert done.stderr.startswith("tam: the service calibrator/save is not offered: are the nodes running")


def test_a_node_that_ends_before_it_answers_is_told(bench, ros_domain, tmp_path):
    """A service whose node is gone in the middle of a call is not waited for.

    It says no goodbye: others hold it for alive for as long as it said, which are two seconds here instead of twenty.
    """
    import signal

    profiles = (configuration_folder() / "fastdds.xml").read_text()
    assert "<sec>20</sec></leaseDuration>" in profiles
    brief = tmp_path / "fastdds.xml"
    brief.write_text(profiles.replace("<sec>20</sec></leaseDuration>", "<sec>2</sec></leaseDuration>"))
    offers = """
import os, rclpy
from std_srvs.srv import Trigger
rclpy.init()
node = rclpy.create_node("short_lived")
node.create_service(Trigger, "ask", lambda request, response: os._exit(0))
rclpy.spin(node)
"""
    environment = os.environ | {"FASTRTPS_DEFAULT_PROFILES_FILE": str(brief)}
    server = subprocess.Popen([sys.executable, "-c", offers], env=environment)
    try:
        done = call("ask")
    finally:
        server.send_signal(signal.SIGKILL)
        server.wait()
    assert done.exit_code == 1
    assert done.stderr.startswith("tam: the node of ask ended before it answered")
