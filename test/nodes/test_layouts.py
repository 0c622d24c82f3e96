"""The layouts of Foxglove, PlotJuggler and RViz name topics that the nodes have, of the types that they are drawn as.

The tools themselves are not here: what they make of the layouts on a screen is not tested.
"""

import json
import re
from importlib import import_module
from xml.etree import ElementTree

import pytest
import yaml

from tam_calibration.files.text_files import configuration_folder

pytest.importorskip("visualization_msgs.msg", reason="the ROS message packages are not installed")

DRAWN_AS = {
    "Marker": "visualization_msgs/msg/Marker",
    "MarkerArray": "visualization_msgs/msg/MarkerArray",
    "PoseWithCovariance": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "PointStamped": "geometry_msgs/msg/PointStamped",
}
"""Types of the displays of rviz_default_plugins."""

OURS = {"center_marker", "coverage_markers", "source_markers", "source_pose", "center", "gradient", "source"}


def test_layouts_name_what_the_nodes_have(bench):
    """Each of the three, against the topics of running nodes."""
    topics = topics_of_nodes(bench)
    for check in (check_foxglove, check_plotjuggler, check_rviz):
        check(topics)


def topics_of_nodes(bench):
    """Return the types of the topics that the nodes have."""
    bench.start_nodes(collector={}, corrector={}, localizer={})
    names = {f"/{name}" for name in OURS}
    found = {}

    def are_seen():
        found.update({name: types[0] for name, types in bench.node.get_topic_names_and_types()})
        heard = all(bench.node.count_subscribers(f"/tam_{number}/magnetic_field") for number in range(1, 5))
        return heard and all(bench.node.count_publishers(name) for name in names)

    bench.spin_until(are_seen, "the topics are there")
    return found


def type_at(message_type, path):
    """Return the type of a field of a message by the names on the way, with [i] for an element of an array."""
    for part in path:
        package, _, name = message_type.replace("/msg/", "/").partition("/")
        message = getattr(import_module(f"{package}.msg"), name)
        field, is_element = re.fullmatch(r"(\w+)(\[\d+\])?", part).groups()
        message_type = message.get_fields_and_field_types()[field]
        if is_element:
            message_type = re.fullmatch(r"sequence<(.+)>|(.+)\[\d+\]", message_type)[1]
    return message_type


def leaves(layout):
    """Return the panels of a layout of Foxglove."""
    return [layout] if isinstance(layout, str) else [*leaves(layout["first"]), *leaves(layout["second"])]


def check_foxglove(topics):
    """Every panel has its place; what is drawn in space are markers and a pose, what is plotted are numbers."""
    layout = json.loads((configuration_folder() / "foxglove.json").read_text())
    panels = layout["configById"]
    assert sorted(leaves(layout["layout"])) == sorted(panels)
    shown = panels["3D!tam"]["topics"]
    assert set(shown) <= set(topics) and {topics[each] for each in shown} <= set(DRAWN_AS.values())
    assert panels["3D!tam"]["followTf"] == "tam_array"
    plots = [panel for name, panel in panels.items() if name.startswith("Plot!")]
    for path in (path for plot in plots for path in plot["paths"]):
        topic, *fields = path["value"].split(".")
        assert type_at(topics[topic], fields) == "double"
        is_stamped = "header" in type_of(topics[topic]).get_fields_and_field_types()
        assert path["timestampMethod"] == ("headerStamp" if is_stamped else "receiveTime")
    assert topics[panels["DiagnosticSummary!tam"]["topicToRender"]] == "diagnostic_msgs/msg/DiagnosticArray"
    assert topics[panels["RosOut!tam"]["topicToRender"]] == "rcl_interfaces/msg/Log"


def type_of(message_type):
    """Return the class of a message."""
    package, _, name = message_type.partition("/msg/")
    return getattr(import_module(f"{package}.msg"), name)


def check_plotjuggler(topics):
    """Every curve is a number of a topic that is subscribed; splitters tell how many plots they hold."""
    root = ElementTree.parse(configuration_folder() / "plotjuggler.xml").getroot()
    subscribed = root.find("Plugins/plugin[@ID='ROS2 Topic Subscriber']/selected_topics").get("value").split(";")
    assert set(subscribed) <= set(topics)
    used = set()
    for curve in root.iter("curve"):
        (topic,) = (each for each in subscribed if curve.get("name").startswith(f"{each}/"))
        assert type_at(topics[topic], curve.get("name").removeprefix(f"{topic}/").split("/")) == "double"
        used.add(topic)
    assert used == set(subscribed)
    for splitter in root.iter("DockSplitter"):
        assert int(splitter.get("count")) == len(splitter.findall("DockArea")) == len(splitter.get("sizes").split(";"))


def check_rviz(topics):
    """Every display has a topic of its type; the namespaces of markers are those that are published."""
    content = yaml.safe_load((configuration_folder() / "tam.rviz").read_text())["Visualization Manager"]
    assert content["Global Options"]["Fixed Frame"] == "tam_array"
    drawn = [each for each in content["Displays"] if "Topic" in each]
    assert len(drawn) == 5
    for display in drawn:
        kind = display["Class"].removeprefix("rviz_default_plugins/")
        assert topics[display["Topic"]["Value"]] == DRAWN_AS[kind]
    assert {name for each in drawn for name in each.get("Namespaces", ())} == {
        "covered",
        "missing",
        "moment",
        "position",
    }
