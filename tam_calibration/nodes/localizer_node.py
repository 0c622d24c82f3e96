"""The localizer node: from field and gradient to the source that makes them."""

import time
from collections import Counter
from pathlib import Path

import numpy as np
import scipy.spatial.transform  # noqa: F401  else it would be loaded while the first samples wait
from geometry_msgs.msg import Point, PointStamped
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header, String

from tam_calibration.calibration import Calibration
from tam_calibration.files import calibration_from_yaml, read_calibration
from tam_calibration.geomagnetic import field_at
from tam_calibration.localization.euler import DIPOLE_INDEX
from tam_calibration.localization.sample_by_sample import Regional, locate_samples, regional_of, turned
from tam_calibration.localization.solutions import EulerSolutions, Status
from tam_calibration.nodes.attitude_join import AttitudeJoin, Joined
from tam_calibration.nodes.base import ERROR, LATCHED, OK, RELIABLE_STREAM, STALE, WARN, Health, TamNode
from tam_calibration.nodes.cloud import make_cloud, read_cloud
from tam_calibration.nodes.parameters import ARRAY_FILE, FRAME_ID, Rule, array_of
from tam_calibration.nodes.signals import Startup
from tam_calibration.nodes.source_rows import source_rows
from tam_calibration.nodes.spinning import spin_node
from tam_calibration.pointcloud_layout import FIELD_GRADIENT_COLUMNS, SOURCE_COLUMNS, SampleLayout
from tam_calibration.problems import InputError
from tam_calibration.units import FloatArray

FITTED, NONE = "fitted", "none"
SILENCE_S = 2.0
_ROUNDING = 1e-9

RULES = (
    ARRAY_FILE,
    FRAME_ID,
    Rule("calibration_file", "", "Calibration YAML that is loaded at the start; a newer one comes over `calibration`."),
    Rule(
        "index", DIPOLE_INDEX, "Structural index: 3 dipole, 2 line of dipoles, 1 line of current.", bounds=(0.1, 10.0)
    ),
    Rule(
        "regional",
        FITTED,
        "Field beside the source's, taken off with the attitude: fitted to the first samples, LAT,LON,DATE for IGRF "
        "there, or none.",
    ),
    Rule("regional_samples", 500, "Samples to which the regional field is fitted.", bounds=(1, 1_000_000)),
    Rule("attitude_noise_rad", 0.0, "Standard deviation of the attitude about each axis [rad].", bounds=(0.0, 1.0)),
    Rule(
        "fixed_frame",
        "",
        "Frame of what is published, with the axes of the attitude's world and the array's centre as origin; empty "
        "for the array frame.",
    ),
)


class Localizer(TamNode):
    """Publishes `source` of every sample that can be located, and `source_estimate` of every sample.

    The attitude is that of `samples`, which the collector has joined: no other clock or tolerance comes in.
    """

    def __init__(self) -> None:
        super().__init__("localizer", RULES)
        self._stated_array = self._array = array_of(self)
        self._calibration: Calibration | None = None
        self._frame_id: str = self.value("fixed_frame") or self.value("frame_id")
        self._given: str = self.value("regional")
        known = () if self._given in (FITTED, NONE) else (Regional(field_at(self._given), self._attitude_noise),)
        self._regional: Regional | None = next(iter(known), None)
        self._join, self._first = AttitudeJoin(), list[Joined]()
        self._problem_of_calibration = self._problem_of_samples = ""
        self._received, self._statuses = 0, Counter[Status]()
        self._newest_ns, self._heard_s = -1, -np.inf
        self._source = self.create_publisher(PointStamped, "source", RELIABLE_STREAM)
        self._estimate = self.create_publisher(PointCloud2, "source_estimate", RELIABLE_STREAM)
        if path := self.value("calibration_file"):
            self._switch(read_calibration(Path(path)))
        self.create_subscription(String, "calibration", self._take_calibration, LATCHED)
        self.create_subscription(PointCloud2, "field_gradient", self._take_outputs, RELIABLE_STREAM)
        if self._needs_attitude:
            self.create_subscription(PointCloud2, "samples", self._take_samples, RELIABLE_STREAM)

    @property
    def _attitude_noise(self) -> float:
        return float(self.value("attitude_noise_rad"))

    @property
    def _needs_attitude(self) -> bool:
        return self._given != NONE or bool(self.value("fixed_frame"))

    @property
    def _is_heard(self) -> bool:
        return bool(self._estimate.get_subscription_count() or self._source.get_subscription_count())

    def health(self) -> Health:
        """Return how many samples were located, and why the others were not."""
        level, message = self._judge()
        refused = {f"refused.{status.name.lower()}": self._statuses[status] for status in Status if status}
        values = {"received": self._received, "located": self._statuses[Status.LOCATED], **refused}
        return Health(level, message, values)

    def _judge(self) -> tuple[bytes, str]:
        if self._problem_of_samples:
            return ERROR, self._problem_of_samples
        if self._problem_of_calibration:
            return WARN, f"a new calibration was not taken: {self._problem_of_calibration}"
        if time.monotonic() - self._heard_s > SILENCE_S:
            return STALE, "no field and gradient arrive: see the corrector"
        if not self._is_heard:
            return OK, "nobody listens to the source: it is not located"
        located = self._statuses[Status.LOCATED]
        refused = Counter({status: count for status, count in self._statuses.items() if status})
        counted = f"{located} of {located + refused.total()} samples located"
        if not refused:
            return OK, counted
        worst, count = refused.most_common(1)[0]
        return OK if located else WARN, f"{counted}; of {count}: {worst.reason}"

    def _take_calibration(self, message: String) -> None:
        try:
            self._switch(calibration_from_yaml(message.data, self.resolve_topic_name("calibration")))
        except InputError as problem:
            self._problem_of_calibration = str(problem)

    def _switch(self, calibration: Calibration) -> None:
        """Take the array and the covariance of a calibration; what was fitted to older outputs is fitted again."""
        if not calibration.is_of(self._stated_array):
            raise InputError("the calibration is of another array: choose the array_file that it was made with")
        self._array, self._calibration, self._problem_of_calibration = calibration.array, calibration, ""
        self._start_over()

    def _start_over(self) -> None:
        self._first = []
        if self._given == FITTED:
            self._regional = None

    def _take_samples(self, cloud: PointCloud2) -> None:
        try:
            columns, rows = read_cloud(cloud)
            has_attitude = SampleLayout.from_columns(columns).attitude
        except InputError as problem:
            self._problem_of_samples = str(problem)
            return
        for row in rows:
            attitude = row[-4:] if has_attitude else np.full(4, np.nan)
            self._answer_all(self._join.push_attitude(_stamp_ns(cloud.header), attitude))

    def _take_outputs(self, cloud: PointCloud2) -> None:
        try:
            columns, rows = read_cloud(cloud)
            if columns != FIELD_GRADIENT_COLUMNS:
                raise InputError(f"field_gradient must have the columns {', '.join(FIELD_GRADIENT_COLUMNS)}")
        except InputError as problem:
            self._problem_of_samples = str(problem)
            return
        self._problem_of_samples, self._heard_s = "", time.monotonic()
        self._received += len(rows)
        stamp_ns = _stamp_ns(cloud.header)
        for row in rows:
            if self._needs_attitude:
                self._answer_all(self._join.push_outputs(stamp_ns, row))
            else:
                self._answer(Joined(stamp_ns, row, None))

    def _answer_all(self, joined: list[Joined]) -> None:
        for one in joined:
            if one.stamp_ns < self._newest_ns:  # a new run
                self._start_over()
            self._newest_ns = one.stamp_ns
            self._answer(one)

    def _answer(self, joined: Joined) -> None:
        if self._given == FITTED and self._regional is None:
            solutions = self._learn(joined)
        elif self._is_heard:
            solutions = self._locate(joined)
        else:
            return
        status = Status(int(solutions.status[0]))
        self._statuses[status] += 1
        self._publish(Header(stamp=Time(nanoseconds=joined.stamp_ns).to_msg(), frame_id=self._frame_id), solutions)

    def _learn(self, joined: Joined) -> EulerSolutions:
        """Keep a sample for the fit of the regional field; none can be located before that."""
        if joined.attitude is None or not np.isfinite(joined.attitude).all():
            return EulerSolutions.refused(1, Status.NO_ATTITUDE)
        if not np.isfinite(joined.outputs[:9]).all():
            return EulerSolutions.refused(1, Status.NOT_FINITE)
        self._first.append(joined)
        if len(self._first) == self.value("regional_samples"):
            outputs = np.array([one.outputs[:9] for one in self._first])
            attitude = np.array([one.attitude for one in self._first])
            self._regional = Regional(regional_of(outputs, attitude), self._attitude_noise)
            self._first = []
        return EulerSolutions.refused(1, Status.NO_REGIONAL)

    def _locate(self, joined: Joined) -> EulerSolutions:
        attitude = np.full((1, 4), np.nan) if joined.attitude is None else joined.attitude[None]
        covariance = self._covariance(joined.outputs[9:])
        try:
            solutions = locate_samples(
                joined.outputs[None, :9],
                self._array,
                covariance,
                index=self.value("index"),
                regional=self._regional,
                attitude=attitude,
            )
        except InputError as problem:
            self._problem_of_samples = str(problem)
            return EulerSolutions.refused(1, Status.NOT_FINITE)
        return turned(solutions, attitude) if self.value("fixed_frame") else solutions

    def _covariance(self, standard_errors: FloatArray) -> FloatArray:
        """Return the (9, 9) covariance of outputs: the calibration's, and what effects left in add to its diagonal."""
        variance = standard_errors**2
        if self._calibration is None:
            return np.diag(variance)
        own = self._calibration.output_covariance
        added = variance - np.diag(own)
        covariance: FloatArray = own + np.diag(np.where(added > _ROUNDING * variance, added, 0.0))
        return covariance

    def _publish(self, header: Header, solutions: EulerSolutions) -> None:
        if solutions.is_located[0] and self._source.get_subscription_count():
            x, y, z = solutions.position_m[0].tolist()
            self._source.publish(PointStamped(header=header, point=Point(x=x, y=y, z=z)))
        if self._estimate.get_subscription_count():
            self._estimate.publish(make_cloud(header, SOURCE_COLUMNS, source_rows(solutions)[0].tolist()))


def _stamp_ns(header: Header) -> int:
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def spin(startup: Startup) -> None:
    """Run the localizer until it is told to end."""
    spin_node(startup, Localizer, EventsExecutor)
