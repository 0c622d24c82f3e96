"""Draw ``docs/images/markers.png`` and ``docs/images/curves.png``: what viewers get from the nodes.

The markers and numbers are those of the messages; the looks of RViz, Foxglove and PlotJuggler are their own. Needs the
message packages of ROS. Run ``python docs/draw_markers.py``.
"""

import re
from pathlib import Path
from xml.etree import ElementTree

import matplotlib
import numpy as np
from draw_source import EARTH_T, passing
from geometry_msgs.msg import Point, PointStamped
from matplotlib import pyplot
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import MagneticField
from std_msgs.msg import Float64MultiArray, Header

from tam_calibration.correction.calibration import Calibration
from tam_calibration.files.text_files import configuration_folder
from tam_calibration.fit import calibrate
from tam_calibration.fit.turns import LiveCoverage
from tam_calibration.localization.solutions import EulerSolutions
from tam_calibration.localization.turned_samples import Regional, Samples, locate_samples, turned
from tam_calibration.messages.point_cloud import GRADIENT_ROW_MAJOR
from tam_calibration.model.recording import Recording
from tam_calibration.nodes.markers import coverage_markers, field_marker, source_markers
from tam_calibration.report.page import PAGE_WIDTH_INCH, STYLE
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate

IMAGES = Path(__file__).parent / "images"
EARLY = 300
"""Samples after which the coverage is drawn for the first time: the first three seconds."""
MOMENTS, PRECISE = 5, 0.1
"""How many sources are drawn, and up to which part of the distance it is uncertain there."""


def place_of(point):
    """Return x, y and z of a point or vector."""
    return np.array([point.x, point.y, point.z])


def draw_marker(axes, marker):
    """Draw a marker of one of the kinds that the nodes publish."""
    colour = (marker.color.r, marker.color.g, marker.color.b, marker.color.a)
    if marker.action == marker.DELETE:
        return
    if marker.type == marker.SPHERE_LIST:
        axes.scatter(*np.transpose([place_of(point) for point in marker.points]), color=colour, s=14, depthshade=False)
    elif marker.type == marker.ARROW:
        start, end = map(place_of, marker.points)
        axes.quiver(*start, *(end - start), color=colour, lw=2, arrow_length_ratio=0.2)
    else:
        azimuth, height = np.meshgrid(np.linspace(0, 2 * np.pi, 41), np.linspace(0, np.pi, 21))
        ball = np.stack([np.cos(azimuth) * np.sin(height), np.sin(azimuth) * np.sin(height), np.cos(height)], axis=-1)
        turn = marker.pose.orientation
        axes_of_it = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
        surface = ball * place_of(marker.scale) / 2 @ axes_of_it.T + place_of(marker.pose.position)
        axes.plot_surface(*np.moveaxis(surface, -1, 0), color=colour, lw=0)


def draw_array(axes, array):
    """Draw the arms of the array."""
    for position in array.positions_m:
        axes.plot(*np.transpose([np.zeros(3), position]), color="#3c4650", lw=1.5)


def draw_coverage(axes, recording, title):
    """Draw what the collector shows after a recording, with the field of its last sample."""
    coverage = LiveCoverage()
    coverage.add(recording.readings_T)
    header = Header(frame_id="tam_array")
    for marker in coverage_markers(header, coverage.summary()).markers:
        draw_marker(axes, marker)
    draw_marker(axes, field_marker(header, recording.readings_T[-1].mean(axis=0)))
    axes.set_title(title)
    axes.set(xlim=(-1, 1), ylim=(-1, 1), zlim=(-1, 1), xticks=[], yticks=[], zticks=[])
    axes.set_box_aspect((1, 1, 1), zoom=1.15)


def located(recording: Recording, calibration: Calibration) -> tuple[np.ndarray, EulerSolutions]:
    """Return the corrected outputs of a pass, and the source of each sample in a level frame."""
    corrected = calibration.correct(recording)
    regional = Regional(EARTH_T, 1e-4)
    samples = Samples(corrected.outputs, calibration.array, calibration.output_covariance, recording.attitude)
    solutions = locate_samples(samples, regional)
    return corrected.outputs, turned(solutions, recording.attitude)


def draw_source_markers(axes, calibration, solutions):
    """Draw the sources of some samples, as they are shown one after another."""
    place, covariance = solutions.position_m, solutions.position_covariance_m2
    precise = np.sqrt(np.einsum("ni,nij,nj->n", place, covariance, place)) < PRECISE * solutions.distance_m**2
    found = np.flatnonzero(solutions.is_located & precise)
    draw_array(axes, calibration.array)
    for index in found[np.linspace(0, len(found) - 1, MOMENTS).astype(int)]:
        for marker in source_markers(Header(frame_id="level"), solutions, int(index)).markers:
            draw_marker(axes, marker)
    axes.set_title(f"source: {MOMENTS} moments of a pass (m)")
    axes.set_aspect("equal")
    axes.tick_params(labelsize=6)


def draw_markers(calibration, run, solutions):
    """Draw what is shown in space."""
    figure = pyplot.figure(figsize=(PAGE_WIDTH_INCH, 2.7), layout="constrained")
    axes = [figure.add_subplot(1, 3, number, projection="3d") for number in (1, 2, 3)]
    draw_coverage(axes[0], run.take(slice(0, EARLY)), "coverage and field: after 3 s")
    draw_coverage(axes[1], run, f"after {np.ptp(run.time_s):.0f} s")
    draw_source_markers(axes[2], calibration, solutions)
    figure.savefig(IMAGES / "markers.png", dpi=120)


def messages_of(outputs, solutions):
    """Return the messages of each sample by topic; none of a source that was not located."""
    centers, gradients, sources = [], [], []
    for output, place, is_located in zip(outputs, solutions.position_m, solutions.is_located, strict=True):
        center = MagneticField()
        center.magnetic_field.x, center.magnetic_field.y, center.magnetic_field.z = output[:3].tolist()
        x, y, z = place.tolist()
        centers.append(center)
        gradients.append(Float64MultiArray(data=output[list(GRADIENT_ROW_MAJOR)].tolist()))
        sources.append(PointStamped(point=Point(x=x, y=y, z=z)) if is_located else None)
    return {"/center": centers, "/gradient": gradients, "/source": sources}


def value_of(message, path):
    """Return a number of a message by the names that PlotJuggler gives it."""
    for name, index in re.findall(r"(\w+)(?:\[(\d+)\])?", path):
        message = getattr(message, name)
        message = message[int(index)] if index else message
    return message


def draw_curves(time_s, messages):
    """Draw the plots of the layout of PlotJuggler whose topics there are."""
    areas = ElementTree.parse(configuration_folder() / "plotjuggler.xml").getroot().iter("DockArea")
    areas = [area for area in areas if area.find("plot/curve").get("name").startswith(tuple(f"{t}/" for t in messages))]
    figure, all_axes = pyplot.subplots(
        len(areas), 1, figsize=(PAGE_WIDTH_INCH, 1.5 * len(areas)), sharex=True, layout="constrained"
    )
    for axes, area in zip(all_axes, areas, strict=True):
        for curve in area.iter("curve"):
            topic = next(each for each in messages if curve.get("name").startswith(f"{each}/"))
            path = curve.get("name").removeprefix(f"{topic}/")
            values = [np.nan if each is None else value_of(each, path) for each in messages[topic]]
            axes.plot(time_s - time_s[0], values, color=curve.get("color"), lw=0.8, label=curve.get("name"))
        axes.set_title(area.get("name"), loc="left")
        axes.legend(fontsize=6, frameon=False, loc="upper right")
    all_axes[-1].set_xlabel("time (s)")
    figure.savefig(IMAGES / "curves.png", dpi=120)


def main() -> None:
    """Calibrate, pass a wreck, and draw what is published."""
    run = simulate(read_scenario("tumble_100_hz"))
    calibration = calibrate(run.recording, run.scenario.array)
    recording = passing(calibration, run.scenario.errors)
    outputs, solutions = located(recording, calibration)
    with matplotlib.rc_context(STYLE):
        draw_markers(calibration, run.recording, solutions)
        draw_curves(recording.time_s, messages_of(outputs, solutions))


if __name__ == "__main__":
    main()
