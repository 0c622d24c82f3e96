"""What the localizer holds back: outputs until their attitude comes, and lines whose targets a thread searches."""

from collections import deque
from functools import partial
from typing import NamedTuple

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
from tam_calibration.nodes.base import TamNode, Work
from tam_calibration.nodes.markers import target_markers
from tam_calibration.nodes.topics import RELIABLE_STREAM

LONGEST_WAIT = 100
"""Outputs that wait for their sample; the oldest beyond these goes on without attitude."""


class Joined(NamedTuple):
    """Outputs with their stamp and attitude; None where the attitude did not come."""

    stamp_ns: int
    outputs: FloatArray
    attitude: FloatArray | None


class AttitudeJoin:
    """Joins two streams, each in the order of its stamps until one of them starts over.

    Everything that is pushed as outputs comes out once, with or without attitude.
    """

    def __init__(self) -> None:
        self._attitudes: dict[int, FloatArray] = {}
        self._waiting: deque[tuple[int, FloatArray]] = deque()
        self._newest_attitude = self._newest_outputs = -1

    def push_attitude(self, stamp_ns: int, attitude: FloatArray) -> list[Joined]:
        """Take the attitude of a sample and return the outputs that waited for it.

        Parameters
        ----------
        stamp_ns : int
            Stamp of the sample, nanoseconds; one that does not rise begins a new run.
        attitude : (4,) array
            Quaternion x, y, z, w that turns the array frame into the world.
        """
        if stamp_ns <= self._newest_attitude:
            self._attitudes.clear()
        self._newest_attitude = stamp_ns
        self._attitudes[stamp_ns] = attitude
        if len(self._attitudes) > 1000:  # that wait for their outputs
            del self._attitudes[next(iter(self._attitudes))]
        return self._drain()

    def push_outputs(self, stamp_ns: int, outputs: FloatArray) -> list[Joined]:
        """Take the outputs of a sample and return those that need not wait.

        Parameters
        ----------
        stamp_ns : int
            Stamp of the sample, nanoseconds; one that does not rise begins a new run.
        outputs : (18,) array
            Row of ``field_gradient``: nine outputs, T and T/m, and their standard errors.
        """
        joined = []
        if stamp_ns <= self._newest_outputs:  # a new run: what still waits is of the old one
            joined = [self._join(*self._waiting.popleft()) for _ in range(len(self._waiting))]
            if stamp_ns not in self._attitudes:
                self._newest_attitude = -1
        self._newest_outputs = stamp_ns
        self._waiting.append((stamp_ns, outputs))
        return joined + self._drain()

    def _drain(self) -> list[Joined]:
        joined = []
        while self._waiting and self._is_answerable(self._waiting[0][0]):
            joined.append(self._join(*self._waiting.popleft()))
        return joined

    def _is_answerable(self, stamp_ns: int) -> bool:
        return stamp_ns in self._attitudes or stamp_ns < self._newest_attitude or len(self._waiting) > LONGEST_WAIT

    def _join(self, stamp_ns: int, outputs: FloatArray) -> Joined:
        return Joined(stamp_ns, outputs, self._attitudes.pop(stamp_ns, None))


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
        self._line.push_position(stamp.sec + stamp.nanosec / 1e9, np.array([place.x, place.y, place.z]))

    def take_sample(self, stamp_ns: int, readings_T: FloatArray, attitude: FloatArray, rates: FloatArray) -> None:
        """Take a sample: readings (K, 3), tesla, attitude (4,) and angular velocity (3,), rad/s; NaN where unknown."""
        self._line.push_sample(stamp_ns / 1e9, readings_T, attitude, rates)

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
