"""The localizer node: from field and gradient to the source that makes them."""

import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from importlib import import_module
from itertools import groupby

import numpy as np
from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from tam_calibration.correction.calibration import Calibration
from tam_calibration.correction.streaming import PartialCorrection
from tam_calibration.localization.euler import DIPOLE_INDEX
from tam_calibration.localization.solutions import EulerSolutions, Status, pose_rows
from tam_calibration.localization.turned_samples import Regional, Samples, locate_samples, regional_of, turned
from tam_calibration.messages.point_cloud import FIELD_GRADIENT_COLUMNS, SOURCE_COLUMNS, layout_of
from tam_calibration.messages.stream import SILENCE_NS
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import LOCAL_VARIANCE_T2, field_at
from tam_calibration.model.units import FloatArray
from tam_calibration.nodes.base import ERROR, OK, STALE, WARN, Health
from tam_calibration.nodes.calibrated import CALIBRATED, CalibratedNode
from tam_calibration.nodes.markers import Shown, source_markers
from tam_calibration.nodes.node_parameters import Rule
from tam_calibration.nodes.survey import AttitudeJoin, Joined, LineTargets
from tam_calibration.nodes.topics import RELIABLE_STREAM, CloudReader, MessageWriter, cloud_writer, from_stamp, to_stamp

_FITTED, _NONE = "fitted", "none"
RULES = (
    *CALIBRATED,
    Rule(
        "index", DIPOLE_INDEX, "Structural index: 3 dipole, 2 line of dipoles, 1 line of current.", bounds=(0.1, 10.0)
    ),
    Rule(
        "regional",
        _FITTED,
        "Regional field, subtracted with the attitude: fitted to the first samples, LAT,LON,DATE for IGRF "
        "there, or none.",
    ),
    Rule("regional_samples", 500, "Samples to which the regional field is fitted.", bounds=(1, 1_000_000)),
    Rule("attitude_noise_rad", 0.0, "Standard deviation of the attitude about each axis [rad].", bounds=(0.0, 1.0)),
    Rule(
        "batch_s",
        0.0,
        "Time for which samples are gathered to be located at once [s]; 0: each when it comes, at up to ten times the "
        "cost.",
        bounds=(0.0, 0.5),
    ),
    Rule(
        "targets_s",
        0.0,
        "Time of the last stretch of a line in which targets are searched, positions from `odometry` [s]; 0: none.",
        bounds=(0.0, 1000.0),
    ),
    Rule("targets_period_s", 5.0, "Time from one search for targets to the next [s].", bounds=(0.1, 1000.0)),
    Rule(
        "fixed_frame",
        "",
        "Frame of what is published, with the axes of the attitude's world and the array's centre as origin; empty "
        "for the array frame.",
    ),
)


def source_rows(solutions: EulerSolutions) -> FloatArray:
    """Return solutions as the (N, 19) rows of ``pointcloud_layout.SOURCE_COLUMNS``."""
    row, column = np.triu_indices(3)
    parts = (
        solutions.position_m,
        solutions.position_covariance_m2[:, row, column],
        solutions.moment_Am2,
        solutions.moment_covariance_A2m4[:, row, column],
        solutions.status[:, None],
    )
    return np.concatenate(parts, axis=1)


_ROUNDING = np.sqrt(np.finfo(float).eps)
"""Relative difference of variances from which on it is more than rounding."""


class Localizer(CalibratedNode):
    """Publishes `source` of every sample that can be located, and `source_estimate` of every sample.

    The attitude is that of `samples`, which the collector has joined: no other clock or tolerance comes in.
    """

    def __init__(self) -> None:
        super().__init__("localizer", RULES)
        self._partial: PartialCorrection | None = None
        import_module("scipy.spatial.transform")  # else it would be loaded while the first samples wait
        self._given: str = self.value("regional")
        self._attitude_noise: float = self.value("attitude_noise_rad")
        self._is_turned = bool(self.value("fixed_frame"))
        self._needs_attitude = self._given != _NONE or self._is_turned or bool(self.value("targets_s"))
        self._regional: Regional | None = None
        if self._given not in (_FITTED, _NONE):
            self._regional = Regional(field_at(self._given), self._attitude_noise, LOCAL_VARIANCE_T2)
        self._join, self._first = AttitudeJoin(), list[Joined]()
        self._received, self._statuses = 0, Counter[Status]()
        frame_id: str = self.value("fixed_frame") or self.value("frame_id")
        self._source = self.offer(PointStamped, "source", RELIABLE_STREAM)
        self._source_writer = MessageWriter(PointStamped(header=Header(frame_id=frame_id)), 3)
        self._pose = self.offer(PoseWithCovarianceStamped, "source_pose", RELIABLE_STREAM)
        self._pose_writer = MessageWriter(PoseWithCovarianceStamped(header=Header(frame_id=frame_id)), 43)
        self._markers = Shown(self, MarkerArray, "source_markers", frame_id)
        self._estimate = self.offer(PointCloud2, "source_estimate", RELIABLE_STREAM)
        self._estimate_writer = cloud_writer(SOURCE_COLUMNS, frame_id)
        self._targets: LineTargets | None = None
        if span_s := self.value("targets_s"):
            self._targets = LineTargets(self, span_s, self.value("targets_period_s"), self._attitude_noise)
        told = self.take_calibrations()
        self._layout_of = partial(layout_of, sensor_count=self._array.sensor_count)
        checks: dict[str, Callable[[tuple[str, ...]], object]]
        checks = {"field_gradient": _require_outputs, "samples": self._layout_of}
        self._readers = {topic: CloudReader(partial(self.refuse, topic), check) for topic, check in checks.items()}
        # Attitudes first, so that no outputs wait for one that is there.
        topics = [(PointCloud2, "samples", self._take_samples)] if self._needs_attitude else []
        topics.append((PointCloud2, "field_gradient", self._take_outputs))
        if batch_s := self.value("batch_s"):
            self.listen_in_turns(topics, batch_s, RELIABLE_STREAM)
        else:
            for message_type, topic, take in topics:
                self.listen_to_all(message_type, topic, take, RELIABLE_STREAM)
        self.say_start(told, f"waits for {' and '.join(topic for _, topic, _ in topics)}")

    @property
    def _is_heard(self) -> bool:
        topics = (self._estimate, self._source, self._pose, self._markers.publisher)
        return any(topic.get_subscription_count() for topic in topics)

    def health(self) -> Health:
        """Return how many samples were located, and why the others were not."""
        level, message = self._judge()
        refused = {f"refused.{status.name.lower()}": self._statuses[status] for status in Status if status}
        values: dict[str, object] = {"received": self._received, "located": self._statuses[Status.LOCATED], **refused}
        if self._targets is not None:
            found = self._targets
            values |= {"targets": found.found, "targets_problem": found.problem, "targets_attitude": found.note}
        return Health(level, message, values)

    def _judge(self) -> tuple[bytes, str]:
        for reader in self._readers.values():
            if reader.problem:
                return ERROR, reader.problem
        if self._problem_of_calibration:
            return WARN, f"a new calibration was not taken: {self._problem_of_calibration}"
        if time.monotonic() - self._heard_s > SILENCE_NS / 1e9:
            return STALE, "no field and gradient arrive: see the corrector"
        if not self._is_heard:
            return OK, "no node subscribes to the source: it is not located"
        located = self._statuses[Status.LOCATED]
        refused = Counter({status: count for status, count in self._statuses.items() if status})
        counted = f"{located} of {located + refused.total()} samples located"
        if not refused:
            return OK, counted
        worst, count = refused.most_common(1)[0]
        return OK if located else WARN, f"{counted}; of {count}: {worst.reason}"

    def switch(self, calibration: Calibration) -> None:
        """Take the array and the covariance of a calibration; what was fitted to older outputs is fitted again."""
        self._partial = PartialCorrection(calibration)
        if self._targets is not None:
            self._targets.calibration = calibration
        self._run.start_over()
        self._forget_regional()

    def _forget_regional(self) -> None:
        self._first = []
        if self._given == _FITTED:
            self._regional = None

    def _take_samples(self, messages: list[bytes]) -> None:
        joined: list[Joined] = []
        for rows in self._readers["samples"].read(messages):
            layout = self._layout_of(rows.columns)
            attitudes, rates = (layout.channel(rows.values, channel) for channel in ("attitude", "gyroscope"))
            stamps = list(map(from_stamp, rows.stamps))
            for stamp_ns, attitude in zip(stamps, attitudes, strict=True):
                joined += self._join.push_attitude(stamp_ns, attitude)
            if self._targets is not None:
                readings = rows.values[:, 1 : 1 + 3 * self._array.sensor_count].reshape(len(stamps), -1, 3)
                for each in zip(stamps, readings, attitudes, rates, strict=True):
                    self._targets.take_sample(*each)
        self._answer(joined)

    def _take_outputs(self, messages: list[bytes]) -> None:
        joined: list[Joined] = []
        for rows in self._readers["field_gradient"].read(messages):
            self._heard_s = time.monotonic()
            self._received += len(rows.values)
            for stamp_ns, row in zip(map(from_stamp, rows.stamps), rows.values, strict=True):
                joined += (
                    self._join.push_outputs(stamp_ns, row) if self._needs_attitude else [Joined(stamp_ns, row, None)]
                )
        self._answer(joined)

    def _answer(self, joined: Iterable[Joined]) -> None:
        """Answer samples in their order; those that follow each other are located at once."""
        waiting: list[Joined] = []
        for one in joined:
            if self._run.begins_again(one.stamp_ns, one.outputs.tobytes()):
                self._locate(waiting)
                waiting = []
                self._forget_regional()
            if self._given == _FITTED and self._regional is None:
                self._tell([one], EulerSolutions.refused(1, self._learn(one)))
            else:
                waiting.append(one)
        self._locate(waiting)

    def _learn(self, joined: Joined) -> Status:
        """Keep a sample for the fit of the regional field and return why it is not located."""
        if joined.attitude is None or not np.isfinite(joined.attitude).all():
            return Status.NO_ATTITUDE
        if not np.isfinite(joined.outputs[:9]).all():
            return Status.NOT_FINITE
        self._first.append(joined)
        if len(self._first) == self.value("regional_samples"):
            outputs = np.array([one.outputs[:9] for one in self._first])
            attitude = np.array([one.attitude for one in self._first])
            self._regional = regional_of(outputs, attitude, self._attitude_noise)
            self._first = []
        return Status.NO_REGIONAL

    def _locate(self, joined: Sequence[Joined]) -> None:
        """Locate samples where somebody listens, those of equal standard errors at once."""
        if not self._is_heard:
            return
        for _, alike in groupby(joined, lambda one: one.outputs[9:].tobytes()):
            several = list(alike)
            self._tell(several, self._solutions(several))

    def _solutions(self, joined: Sequence[Joined]) -> EulerSolutions:
        outputs = np.array([one.outputs for one in joined])
        if not np.isfinite(outputs[:, :9]).all(axis=1).any():
            return EulerSolutions.refused(len(joined), Status.NOT_FINITE)
        unknown = np.full(4, np.nan)
        attitude = np.array([unknown if one.attitude is None else one.attitude for one in joined])
        try:
            samples = Samples(
                outputs[:, :9],
                self._calibration.array if self._calibration else self._array,
                self._covariance(outputs[0, 9:]),
                attitude,
                self.value("index"),
            )
            solutions = locate_samples(samples, self._regional)
        except InputError as problem:
            self._readers["field_gradient"].problem = str(problem)
            return EulerSolutions.refused(len(joined), Status.NOT_FINITE)
        if not self._is_turned:
            return solutions
        return turned(solutions, attitude, 0.0 if self._regional is None else self._regional.attitude_noise)

    def _covariance(self, standard_errors: FloatArray) -> FloatArray:
        """Return the (9, 9) covariance of outputs: the calibration's, and what effects left in add to its diagonal.

        Without some of the sensors it is that of the outputs of the others.
        """
        variance = standard_errors**2
        if self._calibration is None or self._partial is None:
            return np.diag(variance)
        own = self._calibration.output_covariance
        added = variance - np.diag(own)
        if (added > _ROUNDING * variance).any() and (
            partial := self._partial.covariance_with(standard_errors)
        ) is not None:
            return partial
        return np.asarray(own + np.diag(np.where(added > _ROUNDING * variance, added, 0.0)))

    def _tell(self, joined: Sequence[Joined], solutions: EulerSolutions) -> None:
        self._statuses.update(map(Status, solutions.status.tolist()))
        stamps = [to_stamp(one.stamp_ns) for one in joined]
        if self._source.get_subscription_count():
            for index in np.flatnonzero(solutions.is_located):
                point = solutions.position_m[index].tobytes()
                self._source.publish(self._source_writer.message(stamps[index], point))
        if self._pose.get_subscription_count():
            rows = pose_rows(solutions)
            for index in np.flatnonzero(solutions.is_located):
                self._pose.publish(self._pose_writer.message(stamps[index], rows[index].tobytes()))
        if solutions.is_located.any() and self._markers.is_wanted():
            newest = int(np.flatnonzero(solutions.is_located)[-1])
            header = self._markers.header(joined[newest].stamp_ns)
            self._markers.publisher.publish(source_markers(header, solutions, newest))
        if self._estimate.get_subscription_count():
            for stamp, row in zip(stamps, source_rows(solutions), strict=True):
                self._estimate.publish(self._estimate_writer.message(stamp, row.tobytes()))


def _require_outputs(columns: tuple[str, ...]) -> None:
    if columns != FIELD_GRADIENT_COLUMNS:
        raise InputError(f"field_gradient must have the columns {', '.join(FIELD_GRADIENT_COLUMNS)}")
