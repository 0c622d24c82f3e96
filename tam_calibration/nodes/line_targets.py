"""The targets of the last stretch of a survey line, found in a thread while the localizer answers sample by sample."""

from functools import partial

import numpy as np
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from visualization_msgs.msg import MarkerArray

from tam_calibration.correction.calibration import Calibration
from tam_calibration.localization.line_data import SlidingLine
from tam_calibration.localization.targets import SurveyLine, find_targets, path_in
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray
from tam_calibration.nodes.answering import Work
from tam_calibration.nodes.base import TamNode
from tam_calibration.nodes.listening import RELIABLE_STREAM
from tam_calibration.nodes.markers import target_markers

_NANOSECONDS = 1e-9
"""Seconds in a nanosecond."""


class LineTargets:
    """Publishes `targets` of the last seconds, in the frame of `odometry`.

    Parameters
    ----------
    node : TamNode
        That has the topics.
    span_s : float
        Time that is searched, seconds.
    period_s : float
        From one search to the next at least, seconds; the next begins when the last has ended.
    attitude_noise : float
        Standard deviation of the attitude about each axis, radians.
    """

    def __init__(self, node: TamNode, span_s: float, period_s: float, attitude_noise: float) -> None:
        self._line, self._work = SlidingLine(span_s), Work()
        self._attitude_noise, self._frame_id = attitude_noise, ""
        self.calibration: Calibration | None = None
        self.found, self.problem, self.note = 0, "", ""
        self._targets = node.offer(MarkerArray, "targets", QoSProfile(depth=10))
        node.create_timer(period_s, self._search)
        node.listen(Odometry, "odometry", self._take_odometry, RELIABLE_STREAM)

    def _take_odometry(self, message: bytes) -> None:
        odometry = deserialize_message(message, Odometry)
        stamp, place = odometry.header.stamp, odometry.pose.pose.position
        self._frame_id = odometry.header.frame_id
        self._line.push_position(stamp.sec + _NANOSECONDS * stamp.nanosec, np.array([place.x, place.y, place.z]))

    def take_sample(self, stamp_ns: int, readings_T: FloatArray, attitude: FloatArray, rates: FloatArray) -> None:
        """Take a sample: readings (K, 3), tesla, attitude (4,) and angular velocity (3,), rad/s; NaN where unknown."""
        self._line.push_sample(_NANOSECONDS * stamp_ns, readings_T, attitude, rates)

    def _search(self) -> None:
        if self.calibration is None or self._work.busy_with or not self._targets.get_subscription_count():
            return
        recording = self._line.recording()
        if recording is not None:
            self._work.begin("targets", partial(self._found, recording, self.calibration), self._publish)

    def _found(self, recording: Recording, calibration: Calibration) -> SurveyLine | str:
        try:
            return find_targets(recording, calibration, path_in(recording), self._attitude_noise)
        except (InputError, Refused) as problem:
            return str(problem)

    def _publish(self, line: SurveyLine | str) -> None:
        self.problem = line if isinstance(line, str) else ""
        if isinstance(line, SurveyLine):
            self.found, self.note = len(line.targets), line.note
            self._targets.publish(target_markers(self._frame_id, line.targets))
