"""`tam nodes`: the nodes together, watched."""

import os
import signal
import time

import pytest
from click.testing import CliRunner
from ros_bench import processes_of

from tam_calibration.cli.main import main
from tam_calibration.fit import calibrate
from tam_calibration.nodes.session import node_commands
from tam_calibration.results import write_calibration

pytest.importorskip("rclpy", reason="rclpy is not installed: pip install 'tam_calibration[ros]'")

COMMAND = ["-u", "-m", "tam_calibration", "nodes"]

SAID = ("collector WAIT: no message yet", "corrector WARN: no calib")

WITH_TWO_NODES = """
from tam_calibration.__main__ import run
from tam_calibration.cli import nodes
all_of = nodes.node_commands
nodes.node_commands = lambda *given: {"stream": all_of(*given)["stream"]}
run()
"""
"""The command with the process of collector and corrector alone: how it ends does not depend on the others."""


def start_two(bench, before=""):
    """Start the command with two nodes, after some code, and wait until both have said something."""
    children = bench.start({"tam": ["-u", "-c", before + WITH_TWO_NODES, "nodes"]})
    bench.spin_until(lambda: all(line in children.log("tam") for line in SAID), "the nodes say what they wait for")
    return children


def ended(bench, children, number):
    """Send the command a signal, and return its exit code once it has ended its nodes, one after another."""
    os.kill(children.pids["tam"], number)
    bench.spin_until(lambda: not children.is_running("tam"), "the command has ended")
    return children.end_one("tam")


def test_nodes_take_their_files_and_say_what_happens(bench, recording, cross, tmp_path):
    """Three nodes load the calibration, the collector the map; what they say is printed line by line.

    A second command is refused while the first goes on; Ctrl-C after Ctrl-C ends it and its nodes with exit code 0.
    """
    path = tmp_path / "calibration.yaml"
    write_calibration(path, calibrate(recording, cross))
    heard = [f"/tam_{sensor}/magnetic_field" for sensor in (1, 2, 3)]
    picks = ", ".join(f"{{topic: {topic}}}" for topic in (*heard, "/silent"))
    (tmp_path / "map.yaml").write_text(f"sensors: [{picks}]\n")
    options = ["--calibration", str(path), "--map", str(tmp_path / "map.yaml")]
    children = bench.start({"tam": [*COMMAND, *options]})

    def loaded():
        logs = "".join(log.read_text() for log in bench.logs.glob("tam_nodes_*/*.log"))
        said = f"]: array cross; calibration {path}, "
        return [name for name in ("calibrator", "corrector", "localizer") if f"[{name}{said}" in logs]

    bench.spin_until(lambda: len(loaded()) == 3, "all have loaded it")
    waits = f"no message yet on {', '.join(heard)}, /silent: "
    bench.spin_until(lambda: waits in children.log("tam"), "it waits for these topics")
    result = CliRunner().invoke(main, ["nodes"])
    assert result.exit_code == 2
    assert " runs already in ROS domain" in result.output.splitlines()[-1]
    bench.stream(recording, [bench.publish_sensors((1, 2, 3), scalar=False)])
    bench.spin_until(lambda: "collector ERROR: nothing from " in children.log("tam"), "the silent sensor is told")

    def ends():
        os.kill(children.pids["tam"], signal.SIGINT)
        return not children.is_running("tam")

    limit = time.monotonic() + 60
    while not ends():
        assert time.monotonic() < limit
        bench.executor.spin_once(timeout_sec=0.05)
    assert children.end_one("tam") == 0, children.log("tam")
    bench.spin_until(lambda: not processes_of(bench.logs), "all have ended")


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGHUP, signal.SIGTERM])
def test_nodes_end_with_the_command(bench, number):
    """Nodes do not outlive a command that is killed, is ended, or whose terminal is gone."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # which nohup has it ignored
    children = start_two(bench)
    signal.signal(signal.SIGHUP, before)
    assert ended(bench, children, number) == (-number if number == signal.SIGKILL else 0)
    bench.spin_until(lambda: not processes_of(bench.logs), "all have ended")


def test_nodes_end_with_a_command_that_is_killed_while_it_starts_them(bench):
    """Nor does a node that had not yet begun."""
    children = bench.start({"tam": COMMAND})
    bench.spin_until(lambda: len(processes_of(bench.logs)) > 1, "a node is started")
    children.end_one("tam", signal.SIGKILL)
    bench.spin_until(lambda: not processes_of(bench.logs), "all have ended")


def test_nodes_stay_when_the_terminal_of_nohup_is_gone(bench):
    """Who ignores SIGHUP before the start means it."""
    deaf = "import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)"
    children = start_two(bench, deaf)
    running = processes_of(bench.logs)
    for process in running:
        os.kill(process, signal.SIGHUP)
    bench.health("collector", lambda *_: True, "the collector goes on")
    assert processes_of(bench.logs) == running
    assert ended(bench, children, signal.SIGINT) == 0


def test_node_that_fails_ends_all(ros_domain, tmp_path, monkeypatch):
    """A node that refuses its parameters ends the command with its sentence and exit code 2."""
    parameters = tmp_path / "parameters.yaml"
    parameters.write_text("collector:\n  ros__parameters:\n    tolerance_s: soon\n")
    stream = {"stream": node_commands(params_file=parameters)["stream"]}
    monkeypatch.setattr("tam_calibration.cli.nodes.node_commands", lambda *given: stream)
    result = CliRunner().invoke(main, ["nodes", "--params-file", str(parameters)])
    assert result.exit_code == 2
    assert "of type 'STRING', expecting type 'DOUBLE': tolerance_s" in result.output.splitlines()[-1]


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
