"""A node's process: what it says at the start, how it ends, and what it refuses to begin with."""

import os
import select
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from importlib import import_module

import pytest
import yaml
from ros_bench import own_lines

from tam_calibration.files.text_files import configuration_folder
from tam_calibration.fit import calibrate
from tam_calibration.model.exceptions import Refused
from tam_calibration.nodes.session import START, Children, configure_fast_dds
from tam_calibration.results import write_calibration

NODES = ("collector", "calibrator", "corrector", "localizer")


def test_signal_ends_a_node_well(bench):
    """SIGINT and SIGTERM end a node with exit code 0 and nothing on its output but the line of the start."""
    numbers = {"collector": signal.SIGINT, "calibrator": signal.SIGTERM}
    children = bench.start({name: [*START, name] for name in numbers})
    bench.spin_until(lambda: all(own_lines(children.log(name)) for name in numbers), "each has said that it started")
    assert {name: children.end_one(name, number) for name, number in numbers.items()} == dict.fromkeys(numbers, 0)
    assert [len(own_lines(children.log(name))) for name in numbers] == [1, 1]


def test_unusable_parameter_ends_the_node_with_a_sentence(bench, tmp_path):
    """It ends with exit code 2."""
    maps = {
        "text": "sensors: [{columns: [a, b, c]}]\ntime: {column: t}\n",
        "one": "sensors: [{topic: /mag}]\n",
        "none": "sensors: [{topic: /a, type: no_msgs/msg/Mag}, {topic: /b}, {topic: /c}, {topic: /d}]\n",
    }
    for name, text in maps.items():
        (tmp_path / name).write_text(text)
    refused = {
        ("collector", f"map_file:={tmp_path}/text"): "text is the map of a text file or log",
        ("collector", f"map_file:={tmp_path}/one"): "one has 1 sensors, the array 4",
        ("collector", f"map_file:={tmp_path}/none"): "/a has messages of type no_msgs/msg/Mag, which is not installed",
        ("collector", "tolerance_s:=soon"): "of type 'STRING', expecting type 'DOUBLE': tolerance_s",
        ("collector", "silence_s:=-1.0"): "out of range Min: 0.1",
        ("collector", "scalar_type:=std_msgs/Int32"): "is not one of: sensor_msgs/MagneticField, std_msgs/Float64",
        ("calibrator", "method:=magic"): "is not one of: maximum_likelihood",
        ("calibrator", "array_file:=/array.yaml"): "/array.yaml",
        (
            "corrector",
            "calibration_file:=/calibration.yaml",
        ): "/calibration.yaml does not exist: leave calibration_file out",
        ("collector", "qos_overrides./samples.publisher.depth:=-1"): "must be an integer from 1 to 1000000, not -1",
        ("localizer", "qos_overrides./source_pose.publisher.durability:=5"): "must be one of volatile, transient_local",
        ("localizer", "index:=0.0"): "Max: 10.0, value: 0.0: index",
        ("localizer", "index:=11"): "Max: 10.0, value: 11.0: index",
        ("localizer", "regional:=here"): "a place must be LAT,LON,DATE",
    }
    commands = {  # in a namespace each: two of one name would end for that
        str(number): [*START, name, "--ros-args", "-r", f"__ns:=/n{number}", "-p", parameter]
        for number, (name, parameter) in enumerate(refused)
    }
    children = bench.fork(commands)
    bench.children.remove(children)  # spin without the check that all still run
    bench.spin_until(lambda: not any(map(children.is_running, commands)), "each has ended")
    assert children.end() == dict.fromkeys(commands, 2)
    for sentence, log in zip(refused.values(), map(children.log, commands), strict=True):
        (error,) = own_lines(log)
        assert error.startswith("tam: ") and sentence in error


@pytest.mark.parametrize(("name", "nodes"), [("localizer", "Localizer"), ("stream", "Collector and Corrector")])
def test_help_starts_no_node(name, nodes):
    """It is a line on what runs, and how parameters are given."""
    done = subprocess.run([sys.executable, *START, name, "--help"], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(f"Runs {nodes} until Ctrl-C. Parameters: --ros-args -p name:=value")


def test_unusable_arguments_end_the_node_with_a_sentence(bench, tmp_path):
    """A file of parameters that is not there, or whose aliases ROS does not take, is not a traceback."""
    parameters = tmp_path / "aliases.yaml"
    parameters.write_text("/**:\n  ros__parameters: {frame_id: &name a, array_file: *name}\n")
    for path in ("/nowhere.yaml", str(parameters)):
        children = bench.fork({"collector": [*START, "collector", "--ros-args", "--params-file", path]})
        bench.children.remove(children)  # spin without the check that it still runs
        bench.spin_until(lambda children=children: not children.is_running("collector"), "it has ended")
        log = children.log("collector")
        assert log.splitlines()[-1].startswith("tam: ROS cannot begin: ") and "Traceback" not in log
        assert children.end() == {"collector": 2}


@pytest.mark.parametrize(
    ("variable", "value", "sentence"),
    [
        ("ROS_LOG_DIR", "/proc", "Failed opening file /proc/"),
        ("ROS_DOMAIN_ID", "abc", "ROS_DOMAIN_ID is not an integral number"),
        ("ROS_DOMAIN_ID", "233", "ROS_DOMAIN_ID is 233: DDS has ports for 0 to 232 only"),
    ],
)
def test_unusable_variables_are_one_sentence(monkeypatch, variable, value, sentence):
    """Commands that use ROS end with exit 2, also where Fast DDS would have ended the process."""
    monkeypatch.setenv(variable, value)
    line = [sys.executable, "-m", "tam_calibration", "call", "calibrator/calibrate"]
    ended = subprocess.run(line, capture_output=True, text=True, timeout=60)
    assert ended.returncode == 2
    assert ended.stderr.startswith("tam: ") and sentence in ended.stderr and len(ended.stderr.splitlines()) == 1


@pytest.mark.parametrize(("words", "codes"), [("", (130, 143)), ("exit_code=0", (0, 0))])
def test_a_signal_ends_what_uses_ros_with_the_code_that_shells_have_for_it(ros_domain, words, codes):
    """But for what would not end otherwise, where it is the usual end."""
    for number, code in zip((signal.SIGINT, signal.SIGTERM), codes, strict=True):
        lines = [
            "import signal",
            "from tam_calibration.nodes.session import ros_session",
            f"with ros_session({words}):",
        ]
        script = "\n".join([*lines, f"    signal.raise_signal({int(number)})"])
        ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
        assert (ended.returncode, ended.stderr) == (code, "")


def test_a_folder_that_is_gone_is_one_sentence(ros_domain, tmp_path):
    """Fast DDS would complain on standard output."""
    line = shlex.join([sys.executable, "-m", "tam_calibration", "call", "calibrator/calibrate"])
    script = f"cd {shlex.quote(str(tmp_path))}; mkdir gone; cd gone; rmdir ../gone; exec {line}"
    ended = subprocess.run(["sh", "-c", script], capture_output=True, text=True, timeout=60)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr == "tam: the folder in which this was called is gone: go to another one\n"


def test_a_failure_of_rclpy_where_the_signal_came_changes_no_exit_code(ros_domain):
    """It takes the exception out of a callback for a failure of its own."""
    lines = [
        "import signal",
        "from tam_calibration.nodes.session import ros_session",
        "with ros_session():",
        "    try:",
    ]
    lines += [
        "        signal.raise_signal(signal.SIGTERM)",
        "    except SystemExit:",
        "        raise RuntimeError('lost')",
    ]
    ended = subprocess.run([sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, timeout=60)
    assert (ended.returncode, ended.stderr) == (143, "")


def test_few_open_files_are_one_sentence(ros_domain):
    """Where ROS would end in the middle of its work, and not well."""
    line = "ulimit -n 30; exec " + shlex.join([sys.executable, "-m", "tam_calibration", "call", "calibrator/calibrate"])
    ended = subprocess.run(["sh", "-c", line], capture_output=True, text=True, timeout=60)
    assert ended.returncode == 2
    assert ended.stderr == "tam: ROS needs 64 open files at once, and this process may have 30: ulimit -n\n"


def test_shipped_parameters_are_known(bench):
    """Every node takes the shipped file of parameters, which names all its parameters with their defaults."""
    path = configuration_folder() / "tam.yaml"
    commands = {
        name: ["-m", "tam_calibration.nodes.start", name, "--ros-args", "--params-file", str(path)] for name in NODES
    }
    bench.fork(commands)
    bench.spin_until(lambda: set(NODES) <= set(bench.node.get_node_names()), "the nodes are seen")
    stated = yaml.safe_load(path.read_text())["/**"]
    for name in NODES:
        rules = import_module(f"tam_calibration.nodes.{name}_node").RULES
        assert stated[name]["ros__parameters"] == {rule.name: rule.default for rule in rules}


def test_namespace_moves_the_topics(bench):
    """Relative names follow the namespace, so that two arrays can live side by side."""
    bench.fork({"collector": ["-m", "tam_calibration.nodes.start", "collector", "--ros-args", "-r", "__ns:=/auv"]})
    wanted = {"/auv/tam_1/magnetic_field", "/auv/samples", "/diagnostics"}
    topics = bench.node.get_topic_names_and_types
    bench.spin_until(lambda: wanted <= {name for name, _ in topics()}, "the topics are in the namespace")


def test_unknown_parameters_are_warned_of(bench, tmp_path):
    """A file for all nodes of a robot starts them; each says what it does not know, and the nearest that it does."""
    path = tmp_path / "robot.yaml"
    overrides = "qos_overrides./samples.publisher."
    path.write_text(
        "/**:\n  ros__parameters:\n    vehicle_name: auv\n    silence_s: 3.0\n    tolerence_s: 0.1\n"
        f"    {overrides}durabilty: volatile\n    {overrides}depth: 7\n"
    )
    children = bench.fork({"collector": [*START, "collector", "--ros-args", "--params-file", str(path)]})
    _, figures = bench.health("collector", lambda *_: True, "it runs")
    assert sorted(figures["unknown_parameters"].split()) == [f"{overrides}durabilty", "tolerence_s", "vehicle_name"]
    told = [line.partition("the parameter ")[2] for line in children.log("collector").splitlines()]
    without = "is not known here and without effect"
    assert sorted(filter(None, told)) == [
        f"{overrides}durabilty {without}: is {overrides}durability meant?",
        f"tolerence_s {without}: is tolerance_s meant?",
        f"vehicle_name {without}",
    ]


def test_whole_number_is_a_number(bench):
    """`index:=2` is what people write for 2.0."""
    from rcl_interfaces.srv import GetParameters

    bench.start_nodes(localizer={"index": 2})
    client = bench.node.create_client(GetParameters, "localizer/get_parameters")
    bench.spin_until(client.service_is_ready, "the parameters can be asked for")
    answer = client.call_async(GetParameters.Request(names=["index"]))
    bench.spin_until(answer.done, "they are told")
    assert answer.result().values[0].double_value == 2.0


def test_hardware_is_the_array(bench, tmp_path):
    """The name of the array's file tells vehicles apart in /diagnostics."""
    array = tmp_path / "auv_7.yaml"
    shutil.copy(configuration_folder() / "cross.yaml", array)
    bench.start_nodes(collector={"array_file": array}, corrector={})
    assert bench.health("collector", lambda *_: True, "it is told")[0].hardware_id == "auv_7"
    assert bench.health("corrector", lambda *_: True, "it is told")[0].hardware_id == "cross"


def test_start_is_one_line(bench, tmp_path, cross, recording):
    """The array, the calibration and its age, and what is waited for."""
    path, missing = tmp_path / "calibration.yaml", tmp_path / "missing.yaml"
    hour_old = replace(recording, time_s=recording.time_s - recording.time_s[-1] + time.time() - 3600)
    write_calibration(path, calibrate(hour_old, cross))
    parameters = {"calibrator": {"calibration_file": missing}, "localizer": {"regional": "none"}}
    children = bench.start_nodes(collector={}, corrector={"calibration_file": path}, **parameters)
    sensors = ", ".join(f"tam_{sensor}/magnetic_field" for sensor in (1, 2, 3, 4))
    told = {
        "collector": f"array cross; waits for {sensors}",
        "calibrator": f"array cross; no calibration: {missing} is not there yet; keeps samples in {bench.logs}",
        "corrector": f"array cross; calibration {path}, 1.0 h old: Good: tensor residual ",
        "localizer": "array cross; no calibration; waits for field_gradient",
    }
    for name, line in told.items():
        bench.spin_until(lambda name=name: own_lines(children.log(name)), f"{name} has said that it started")
        (said,) = own_lines(children.log(name))
        assert f"]: {line}" in said and (name != "corrector" or said.endswith("; waits for samples"))


def test_a_node_by_itself_has_the_settings_of_all(ros_domain, monkeypatch):
    """`ros2 run` gives no profile of Fast DDS: the node announces itself often nevertheless.

    Its twentieth announcement is heard 0.4 s after the first; without `config/fastdds.xml` that takes 45 s.
    """
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.settimeout(20.0)
        peer.bind(("127.0.0.1", _port_of_a_participant(int(os.environ["ROS_DOMAIN_ID"]), 5)))
        with Children({"collector": [*START, "collector"]}, ros_domain):
            peer.recv(65_536)
            first = time.monotonic()
            for _ in range(19):
                peer.recv(65_536)
            assert time.monotonic() - first < 15.0


def _port_of_a_participant(domain, number):
    """Return the port on which a participant of a domain would hear of others (RTPS 2.5, 9.6.2.3)."""
    return 7400 + 250 * domain + 10 + 2 * number


@pytest.mark.parametrize("variable", ["FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS"])
def test_what_a_user_says_of_fast_dds_stays_in_force(variable, monkeypatch):
    """A profile or a choice of transports of the user's is neither replaced nor overruled by ours."""
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE", raising=False)
    monkeypatch.setenv(variable, "UDPv4")
    configure_fast_dds()
    assert os.environ.get("FASTRTPS_DEFAULT_PROFILES_FILE", "UDPv4") == "UDPv4"


@pytest.mark.parametrize(("end", "told"), [(SystemExit(130), SystemExit), (None, Refused)])
def test_a_process_that_had_to_be_killed_changes_no_exit_code(tmp_path, monkeypatch, end, told):
    """Where the user ended the command; where it ended by itself it is a failure."""
    monkeypatch.setattr("tam_calibration.nodes.session._GRACE_S", 0.1)
    deaf = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); print('deaf', flush=True); signal.pause()"
    with pytest.raises(told), Children({"deaf": ["-c", deaf]}, tmp_path) as children:
        limit = time.monotonic() + 20
        while not children.log("deaf") and time.monotonic() < limit:
            pass
        if end is not None:
            raise end


def test_signal_in_the_middle_of_a_look_at_a_process_does_not_hold_up_its_end(tmp_path):
    """It arrives while `poll` has its lock, which stays locked if the signal raises there: `wait` would not end."""

    class Interrupted:
        def __init__(self, lock):
            self._lock = lock

        def acquire(self, *arguments):
            has_lock = self._lock.acquire(*arguments)
            signal.raise_signal(signal.SIGTERM)
            return has_lock

        def __getattr__(self, name):
            return getattr(self._lock, name)

    came = []
    before = signal.signal(signal.SIGTERM, lambda *_: came.append(lock.locked()))
    with Children({"idle": ["-c", "import signal; signal.pause()"]}, tmp_path) as children:
        lock = children._processes["idle"]._waitpid_lock
        children._processes["idle"]._waitpid_lock = Interrupted(lock)
        children.check()
        children._processes["idle"]._waitpid_lock = lock
        children.end_one("idle", signal.SIGKILL)
    signal.signal(signal.SIGTERM, before)
    assert came == [False]


def test_what_is_forked_ends_with_what_is_killed(tmp_path):
    """Tests that are killed leave no node behind, which the next in its domain would meet."""
    script = tmp_path / "idle.py"
    script.write_text("import signal; signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGTERM]); signal.pause()")
    tests = f"""
from pathlib import Path
from forked_children import ForkedChildren, start_server
start_server()
with ForkedChildren({{"idle": [{str(script)!r}]}}, Path({str(tmp_path)!r})) as children:
    print(children.pids["idle"], flush=True)
    input()
"""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", tests], **pipes, env=environment) as killed:
        idle = os.pidfd_open(int(killed.stdout.readline()))
        killed.kill()
    ended, _, _ = select.select([idle], [], [], 60)
    os.close(idle)
    assert ended
