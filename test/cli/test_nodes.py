"""`tam nodes`: the nodes together, watched."""

import signal

import pytest
from click.testing import CliRunner

from tam_calibration.cli.main import main

pytest.importorskip("rclpy", reason="rclpy is not installed: pip install 'tam_calibration[ros]'")

NODES = ("collector", "calibrator", "corrector", "localizer")


def test_nodes_start_together_and_end_together(bench, recording, tmp_path):
    """All start, what they say is printed line by line, and Ctrl-C ends them with exit code 0."""
    children = bench.start({"tam": ["-u", "-m", "tam_calibration", "nodes", "--calibration", str(tmp_path / "c.yaml")]})
    bench.spin_until(lambda: set(NODES) <= set(bench.node.get_node_names()), "the nodes are seen")
    bench.stream(recording, [bench.publish_sensors((1, 2, 3))])
    bench.spin_until(lambda: "collector WARN: nothing from tam_4" in children.log("tam"), "the silent sensor is told")
    assert children.end_one("tam", signal.SIGINT) == 0
    log = children.log("tam")
    assert "calibrator WAIT: no samples yet" in log and "corrector WARN: no calibration yet" in log
    bench.spin_until(lambda: not set(NODES) & set(bench.node.get_node_names()), "the nodes have gone")


def test_node_that_fails_ends_all(ros_domain, tmp_path):
    """A node that refuses its parameters ends the command with its sentence and exit code 2."""
    parameters = tmp_path / "parameters.yaml"
    parameters.write_text("collector:\n  ros__parameters:\n    tolerence_s: 0.1\n")
    result = CliRunner().invoke(main, ["nodes", "--params-file", str(parameters)])
    assert result.exit_code == 2
    assert result.output.startswith("tam: collector has no parameter tolerence_s")


def test_monitor_shows_bars():
    """Coverage and losses are bars, each node has its row, and news are told once."""
    from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
    from rich.console import Console

    from tam_calibration.nodes.monitor import render_statuses

    figures = {"fraction": "0.25", "enough": "False", "missing": "down and left", "samples": "90", "lost": "10"}
    values = [KeyValue(key=key, value=value) for key, value in figures.items()]
    status = DiagnosticStatus(level=DiagnosticStatus.OK, name="collector", message="turn it over", values=values)
    console = Console(width=120)
    with console.capture() as captured:
        console.print(render_statuses({"collector": status, "calibrator": None}))
    shown = captured.get()
    assert "25%" in shown and "missing: down and left" in shown and "90 samples, 10 messages lost" in shown
    assert "turn it over" in shown and "starting" in shown
