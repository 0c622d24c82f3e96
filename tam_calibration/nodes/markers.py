"""What RViz and Foxglove show: the field, the coverage and the source as markers, where somebody listens."""

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from rclpy.time import Time
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from tam_calibration.fit.coverage import Coverage
from tam_calibration.localization.solutions import EulerSolutions, ellipsoid
from tam_calibration.messages.stream import SILENCE_NS
from tam_calibration.model.units import FloatArray
from tam_calibration.nodes.base import TamNode
from tam_calibration.nodes.session import PERIOD_S

if TYPE_CHECKING:  # with scipy, that a collector does without
    from tam_calibration.localization.targets import Target

METRES_PER_TESLA = 1e4
"""Length of the arrow of the field: half a metre, the baseline of the cross, in the 50 µT of the Earth."""

MOMENT_LENGTH = 0.5
"""Length of the arrow of a moment over the distance of its source: seen at any distance, whatever the moment."""

_FIELD = ColorRGBA(r=0.0, g=0.45, b=0.7, a=1.0)
_SOURCE = ColorRGBA(r=0.84, g=0.37, b=0.0, a=0.4)
_MOMENT = ColorRGBA(r=0.84, g=0.37, b=0.0, a=1.0)
_COVERED = ColorRGBA(r=0.0, g=0.62, b=0.45, a=1.0)
_MISSING = ColorRGBA(r=0.6, g=0.6, b=0.6, a=0.6)


class Shown:
    """A topic for viewers, on which there is a message at most every `PERIOD_S`, and where somebody listens.

    Parameters
    ----------
    node : TamNode
        That publishes it.
    message_type : type
        Of its messages.
    topic : str
        Its name.
    frame_id : str
        Frame of what is shown.

    Attributes
    ----------
    publisher : Publisher
        Of the topic.
    """

    def __init__(self, node: TamNode, message_type: type, topic: str, frame_id: str) -> None:
        # Reliable: what is shown is new ten times a second, and a viewer need not get all.
        self.publisher = node.offer(message_type, topic, QoSProfile(depth=10))
        self._frame_id = frame_id
        self._last_s = -np.inf

    def is_wanted(self) -> bool:
        """Whether a message is wanted now; if so, the next one only after `PERIOD_S`."""
        now = time.monotonic()
        if now < self._last_s + PERIOD_S or not self.publisher.get_subscription_count():
            return False
        self._last_s = now
        return True

    def header(self, stamp_ns: int) -> Header:
        """Return the header of a message with a stamp in nanoseconds."""
        return Header(stamp=Time(nanoseconds=stamp_ns).to_msg(), frame_id=self._frame_id)


def field_marker(header: Header, field_T: FloatArray) -> Marker:
    """Return the arrow of a field (3,), tesla, from the origin: ``METRES_PER_TESLA`` long."""
    return _arrow(header, "center", np.zeros(3), METRES_PER_TESLA * field_T, _FIELD)


def source_markers(header: Header, solutions: EulerSolutions, index: int) -> MarkerArray:
    """Return the ellipsoid that contains a source with 95 %, and the arrow of its moment from there.

    Parameters
    ----------
    header : Header
        Stamp and frame of the source.
    solutions : EulerSolutions
        Sources of samples.
    index : int
        Which of them is shown; it has been located.
    """
    position, moment = solutions.position_m[index], solutions.moment_Am2[index]
    markers = [_ball(header, position, solutions.position_covariance_m2[index])]
    if np.isfinite(moment).all() and moment.any():
        length = MOMENT_LENGTH * float(np.linalg.norm(position))
        tip = position + length / np.linalg.norm(moment) * moment
        markers.append(_arrow(header, "moment", position, tip, _MOMENT))
    for marker in markers:  # of a source that is no longer located
        marker.lifetime = Duration(nanoseconds=SILENCE_NS).to_msg()
    return MarkerArray(markers=markers)


def target_markers(frame_id: str, targets: "Sequence[Target]") -> MarkerArray:
    """Return the ellipsoid of each target of a line, with the arrow of its moment; others before are taken away."""
    header = Header(frame_id=frame_id)
    markers = [Marker(header=header, action=Marker.DELETEALL)]
    for number, target in enumerate(targets):
        length = MOMENT_LENGTH * target.distance_m / float(np.linalg.norm(target.moment_Am2))
        shown = [
            _ball(header, target.position_m, target.position_covariance_m2),
            _arrow(header, "moment", target.position_m, target.position_m + length * target.moment_Am2, _MOMENT),
        ]
        for marker in shown:
            marker.id = number
        markers += shown
    return MarkerArray(markers=markers)


def coverage_markers(header: Header, coverage: Coverage) -> MarkerArray:
    """Return the cells that hold samples, and those that hold none, as two lists of balls on a sphere of one metre."""
    visited = coverage.counts > 0
    parts = (("covered", _COVERED, visited), ("missing", _MISSING, ~visited))
    balls = [_balls(header, name, coverage.directions[chosen], colour) for name, colour, chosen in parts]
    return MarkerArray(markers=balls)


def _ball(header: Header, position: FloatArray, covariance: FloatArray) -> Marker:
    """Return the ellipsoid that contains a position (3,), metres, of a covariance (3, 3) with 95 %."""
    semi_axes, (x, y, z, w) = ellipsoid(covariance)
    ball = _marker(header, "position", Marker.SPHERE, _SOURCE)
    turn = Quaternion(x=float(x), y=float(y), z=float(z), w=float(w))
    ball.pose = Pose(position=_filled(Point, position), orientation=turn)
    ball.scale = _filled(Vector3, 2 * semi_axes)
    return ball


def _balls(header: Header, name: str, places: FloatArray, colour: ColorRGBA) -> Marker:
    """Return balls at places (n, 3), metres; where there are none what was shown before is taken away."""
    marker = _marker(header, name, Marker.SPHERE_LIST, colour)
    marker.action = Marker.ADD if len(places) else Marker.DELETE
    marker.points = [_filled(Point, place) for place in places]
    # On the sphere of coverage, whose radius is a metre: some half of what neighbouring cells are apart.
    marker.scale = _filled(Vector3, np.full(3, 0.15))
    return marker


def _arrow(header: Header, name: str, start: FloatArray, end: FloatArray, colour: ColorRGBA) -> Marker:
    """Return an arrow between places (3,), metres, a twentieth of its length thick."""
    marker = _marker(header, name, Marker.ARROW, colour)
    marker.points = [_filled(Point, start), _filled(Point, end)]
    thickness = float(np.linalg.norm(end - start)) / 20
    marker.scale = Vector3(x=thickness, y=2 * thickness, z=4 * thickness)
    return marker


def _marker(header: Header, name: str, kind: int, colour: ColorRGBA) -> Marker:
    """Return a marker that replaces the one of this name before it."""
    return Marker(header=header, ns=name, id=0, type=kind, action=Marker.ADD, color=colour)


def _filled(kind: type, values: FloatArray) -> Any:
    """Return a message of a kind that has x, y and z."""
    return kind(**dict(zip("xyz", values.tolist(), strict=True)))
