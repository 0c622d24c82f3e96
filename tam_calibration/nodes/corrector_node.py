"""The corrector node: turns samples into the centre vector and the gradient tensor."""

import time
from collections import deque
from pathlib import Path

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Vector3
from rclpy.experimental.events_executor import EventsExecutor
from sensor_msgs.msg import MagneticField, PointCloud2
from std_msgs.msg import Float64MultiArray, Header, MultiArrayDimension, MultiArrayLayout, String

from tam_calibration.calibration import Calibration
from tam_calibration.correction import Correction, why_left_in
from tam_calibration.files import calibration_from_yaml, read_calibration
from tam_calibration.nodes.base import ERROR, LATCHED, OK, RELIABLE_STREAM, STALE, WARN, Health, TamNode
from tam_calibration.nodes.cloud import make_cloud, read_cloud
from tam_calibration.nodes.parameters import ARRAY_FILE, FRAME_ID, Rule, array_of
from tam_calibration.nodes.quality import figures
from tam_calibration.nodes.signals import Startup
from tam_calibration.nodes.spinning import spin_node
from tam_calibration.pointcloud_layout import (
    FIELD_GRADIENT_COLUMNS,
    GRADIENT_DIMENSIONS,
    GRADIENT_ROW_MAJOR,
    SampleLayout,
    center_covariance,
)
from tam_calibration.problems import InputError
from tam_calibration.units import FloatArray, to_nanotesla

RULES = (
    ARRAY_FILE,
    FRAME_ID,
    Rule("calibration_file", "", "Calibration YAML that is loaded at the start; a newer one comes over `calibration`."),
)

WINDOW_SAMPLES = 500
SILENCE_S = 2.0

DOUBTFUL_RATIO = 3.0
"""Residual over the noise floor, or over what the fit left, above which a new calibration is advised."""


class Corrector(TamNode):
    """Publishes `center`, `gradient` and `field_gradient` of every sample, each only where somebody listens.

    The calibration's effects are taken off as far as the channels of a sample tell them; what stays in is said in
    /diagnostics, and the standard errors are larger by its size.
    """

    def __init__(self) -> None:
        super().__init__("corrector", RULES)
        self._array = array_of(self)
        self._frame_id: str = self.value("frame_id")
        self._calibration: Calibration | None = None
        self._correction: Correction | None = None
        self._left_in: tuple[str, ...] = ()
        self._problem_of_calibration = self._problem_of_samples = ""
        self._received = self._corrected = 0
        self._heard_s, self._newest_s = -np.inf, np.nan
        self._squares: deque[float] = deque(maxlen=WINDOW_SAMPLES)
        self._center = self.create_publisher(MagneticField, "center", RELIABLE_STREAM)
        self._gradient = self.create_publisher(Float64MultiArray, "gradient", RELIABLE_STREAM)
        self._field_gradient = self.create_publisher(PointCloud2, "field_gradient", RELIABLE_STREAM)
        if path := self.value("calibration_file"):
            self._switch(read_calibration(Path(path)))
        self.create_subscription(String, "calibration", self._take_calibration, LATCHED)
        self.create_subscription(PointCloud2, "samples", self._take_samples, RELIABLE_STREAM)

    def health(self) -> Health:
        """Return whether samples are corrected, and how far |B| is from the scalar reference."""
        residual_T = float(np.sqrt(np.mean(self._squares))) if self._squares else np.nan
        level, message = self._judge(residual_T)
        values = {
            "received": self._received,
            "corrected": self._corrected,
            "center_residual_T": f"{residual_T:.4g}",
            "center_floor_T": f"{self._calibration.floor.center_intensity_T:.4g}" if self._calibration else "nan",
            "effects": " ".join(self._correction.takes_off) if self._correction else "",
            "effects_left_in": " ".join(self._left_in),
        }
        return Health(level, message, values | figures(self._calibration, self._newest_s))

    def _judge(self, residual_T: float) -> tuple[bytes, str]:
        if self._problem_of_samples:
            return ERROR, self._problem_of_samples
        if self._calibration is None:
            return WARN, self._problem_of_calibration or "no calibration yet: call calibrator/calibrate or give a file"
        if self._problem_of_calibration:
            return WARN, f"a new calibration was not taken, the old one stays: {self._problem_of_calibration}"
        if time.monotonic() - self._heard_s > SILENCE_S:
            return STALE, "no samples arrive: see the collector"
        if self._left_in:
            reasons = "; ".join(map(why_left_in, self._left_in))
            return WARN, f"an effect stays in, the standard errors hold its size: {reasons}"
        if np.isnan(residual_T):
            return OK, "samples are corrected; no scalar reference to compare with"
        floor_T = self._calibration.floor.center_intensity_T
        compared = f"|B| − scalar is {to_nanotesla(residual_T):.3g} nT, noise floor {to_nanotesla(floor_T):.3g} nT"
        if residual_T > DOUBTFUL_RATIO * max(floor_T, self._calibration.in_sample.center_intensity_T):
            return WARN, f"{compared}: calibrate again"
        return OK, compared

    def _take_calibration(self, message: String) -> None:
        """Take a calibration that can be used; the next sample is the first that it corrects."""
        try:
            self._switch(calibration_from_yaml(message.data, self.resolve_topic_name("calibration")))
        except InputError as problem:
            self._problem_of_calibration = str(problem)
            self.get_logger().warning(self._problem_of_calibration)

    def _switch(self, calibration: Calibration) -> None:
        if not calibration.is_of(self._array):
            raise InputError("the calibration is of another array: choose the array_file that it was made with")
        correction = Correction(calibration)
        self._correction = correction if correction.takes_off else None
        self._tell_errors(calibration.output_standard_errors, ())
        self._calibration, self._problem_of_calibration = calibration, ""
        self._squares.clear()

    def _tell_errors(self, standard_errors: FloatArray, left_in: tuple[str, ...]) -> None:
        self._covariance = center_covariance(standard_errors).tolist()
        self._standard_errors, self._left_in = standard_errors.tolist(), left_in

    def _take_samples(self, cloud: PointCloud2) -> None:
        try:
            columns, rows = read_cloud(cloud)
            layout = SampleLayout.from_columns(columns)
            if layout.sensor_count != self._array.sensor_count:
                raise InputError(f"samples of {layout.sensor_count} sensors, the array has {self._array.sensor_count}")
        except InputError as problem:
            self._problem_of_samples = str(problem)
            return
        self._problem_of_samples, self._heard_s = "", time.monotonic()
        self._received += len(rows)
        if self._calibration is not None:
            for row in rows:
                self._correct(self._calibration, cloud.header.stamp, layout, row)

    def _correct(self, calibration: Calibration, stamp: Time, layout: SampleLayout, row: FloatArray) -> None:
        last = 1 + 3 * layout.sensor_count
        readings = row[1:last].reshape(1, -1, 3)
        if self._correction is None or not np.isfinite(readings).all():
            outputs = calibration.apply(readings)[0]
        else:
            outputs = self._without_effects(self._correction, layout, row)
        if layout.scalar and np.isfinite(scalar_T := row[last]):
            self._squares.append(float((np.linalg.norm(outputs[:3]) - scalar_T) ** 2))
        self._newest_s = float(row[0])
        self._corrected += 1
        self._publish(Header(stamp=stamp, frame_id=self._frame_id), outputs.tolist())

    def _without_effects(self, correction: Correction, layout: SampleLayout, row: FloatArray) -> FloatArray:
        batch = correction.correct(layout.recording(np.where(np.isfinite(row), row, np.nan)[None]))
        if batch.left_in != self._left_in:
            self._tell_errors(batch.standard_errors[0], batch.left_in)
        outputs: FloatArray = batch.outputs[0]
        return outputs

    def _publish(self, header: Header, outputs: list[float]) -> None:
        if self._center.get_subscription_count():
            field = Vector3(x=outputs[0], y=outputs[1], z=outputs[2])
            self._center.publish(
                MagneticField(header=header, magnetic_field=field, magnetic_field_covariance=self._covariance)
            )
        if self._array.has_gradient and self._gradient.get_subscription_count():
            data = [outputs[index] for index in GRADIENT_ROW_MAJOR]
            self._gradient.publish(Float64MultiArray(layout=_GRADIENT_LAYOUT, data=data))
        if self._field_gradient.get_subscription_count():
            row = [*outputs, *self._standard_errors]
            self._field_gradient.publish(make_cloud(header, FIELD_GRADIENT_COLUMNS, row))


_GRADIENT_LAYOUT = MultiArrayLayout(
    dim=[MultiArrayDimension(label=label, size=size, stride=stride) for label, size, stride in GRADIENT_DIMENSIONS]
)


def spin(startup: Startup) -> None:
    """Run the corrector until it is told to end."""
    spin_node(startup, Corrector, EventsExecutor)
