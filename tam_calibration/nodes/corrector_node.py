"""The corrector node: turns samples into the centre vector and the gradient tensor."""

import math
import time
from collections import deque
from collections.abc import Iterator, Mapping
from functools import partial
from importlib import import_module

import numpy as np
from sensor_msgs.msg import MagneticField, PointCloud2
from std_msgs.msg import Float64MultiArray, Header, MultiArrayDimension, MultiArrayLayout
from visualization_msgs.msg import Marker

from tam_calibration.correction.acceptance import ScalarAgreement
from tam_calibration.correction.calibration import Calibration
from tam_calibration.correction.streaming import CorrectedBatch, Correction, missing_codes, sensors_of
from tam_calibration.messages import point_cloud
from tam_calibration.messages.point_cloud import SampleLayout, center_covariance, layout_of
from tam_calibration.messages.stream import SILENCE_NS
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray, IntArray
from tam_calibration.nodes.base import ERROR, OK, STALE, WARN, Health
from tam_calibration.nodes.calibrated import CALIBRATED, CalibratedNode, figures
from tam_calibration.nodes.markers import Shown, field_marker
from tam_calibration.nodes.node_parameters import REAL_TIME
from tam_calibration.nodes.session import precede
from tam_calibration.nodes.topics import RELIABLE_STREAM, CloudReader, MessageWriter, Rows, cloud_writer, from_stamp

RULES = (*CALIBRATED, REAL_TIME)


class Corrector(CalibratedNode):
    """Publishes `center`, `gradient` and `field_gradient` of every sample, each only where somebody listens.

    The calibration's effects are taken off as far as the channels of a sample tell them; what stays in is said in
    /diagnostics, and the standard errors are larger by its size.
    """

    def __init__(self) -> None:
        super().__init__("corrector", RULES)
        self._correction: Correction | None = None
        self._missing, self._failing, self._partial_count = 0, 0, 0
        self._left_in: tuple[str, ...] = ()
        self._told = 0  # sensors whose contradiction was logged, as in missing_codes
        self._received = self._corrected = 0
        self._newest_s = np.nan
        # Batches, most of a single sample, whose |B| is compared with the scalar.
        self._lengths: deque[tuple[FloatArray, FloatArray]] = deque(maxlen=500)
        self._layout_of = partial(layout_of, sensor_count=self._array.sensor_count)
        self._reader = CloudReader(partial(self.refuse, "samples"), self._layout_of)
        self._offer_outputs(self.value("frame_id"))
        told = self.take_calibrations()
        self.listen_to_all(PointCloud2, "samples", self._take_samples, RELIABLE_STREAM)
        self._scheduling = precede() if self.value("real_time") else "normal"
        self.say_start(told, "waits for samples" if self._calibration else "waits for calibration and samples")

    def health(self) -> Health:
        """Return whether samples are corrected, and how far |B| is from the scalar reference."""
        agreement = self._agreement()
        level, message = self._judge(agreement)
        values = {
            "received": self._received,
            "corrected": self._corrected,
            "center_residual_T": f"{agreement.residual_T:.4g}",
            "center_floor_T": f"{self._calibration.floor.center_intensity_T:.4g}" if self._calibration else "nan",
            "partial": self._partial_count,
            "missing_sensors": " ".join(map(str, sensors_of(self._missing))),
            "contradicting_sensors": " ".join(map(str, sensors_of(self._failing))),
            "not_determined": " ".join(self._not_determined()),
            "effects": " ".join(self._correction.takes_off) if self._correction else "",
            "effects_left_in": " ".join(self._left_in),
            "scheduling": self._scheduling,
        }
        return Health(level, message, values | figures(self._calibration, self._newest_s))

    def _agreement(self) -> ScalarAgreement:
        """Return the residuals |B| − scalar of the newest samples."""
        agreement = ScalarAgreement()
        if self._lengths:
            fields, scalars = (np.concatenate(parts) for parts in zip(*self._lengths, strict=True))
            agreement.add(fields, scalars)
        return agreement

    def _judge(self, agreement: ScalarAgreement) -> tuple[bytes, str]:
        if self._reader.problem:
            return ERROR, self._reader.problem
        if self._calibration is None:
            return WARN, self._problem_of_calibration or "no calibration yet: call calibrator/calibrate or give a file"
        if self._problem_of_calibration:
            return WARN, f"a new calibration was not taken, the old one stays: {self._problem_of_calibration}"
        if time.monotonic() - self._heard_s > SILENCE_NS / 1e9:
            return STALE, "no samples arrive: see the collector"
        if self._missing or self._failing:
            return self._judge_partial()
        if self._left_in and self._correction is not None:
            reasons = "; ".join(map(self._correction.why_left_in, self._left_in))
            return WARN, f"an effect stays in, the standard errors hold its size: {reasons}"
        if not agreement.samples:
            return OK, "samples are corrected; no scalar reference to compare with"
        doubtful = WARN if agreement.is_doubtful(self._calibration) else OK
        return ERROR if agreement.is_wrong else doubtful, agreement.sentence(self._calibration)

    def _judge_partial(self) -> tuple[bytes, str]:
        """Return level and sentence while sensors are missing: an error where not even the field is determined."""
        names, failing = (" and ".join(map(str, sensors_of(code))) for code in (self._missing, self._failing))
        silent = f"no reading of sensor {names}" if names else ""
        contradicts = f"sensor {failing} contradicts the others" if failing else ""
        told = f"{' and '.join(filter(None, (silent, contradicts)))}: outputs are those of the others"
        unknown = self._not_determined()
        if unknown:
            told = f"{told}, which do not determine {' '.join(unknown)}"
        return ERROR if "bx" in unknown else WARN, told

    def _not_determined(self) -> tuple[str, ...]:
        """Return the outputs that the newest sample does not determine."""
        lacking = self._missing | self._failing
        if not lacking or self._correction is None:
            return ()
        return self._correction.partial.without(lacking).not_determined

    def switch(self, calibration: Calibration) -> None:
        """Correct the next sample with a calibration; effects with a memory keep it."""
        correction = Correction(calibration)
        if correction.takes_off:
            import_module("scipy.linalg")  # else it would be loaded while the first samples wait
        if self._correction is not None:
            correction.go_on(self._correction)
        self._correction = correction
        self._left_in, self._missing, self._failing, self._told = (), 0, 0, 0
        self._lengths.clear()

    def _offer_outputs(self, frame_id: str) -> None:
        header = Header(frame_id=frame_id)
        self._center = self.offer(MagneticField, "center", RELIABLE_STREAM)
        self._center_writer = MessageWriter(MagneticField(header=header), 12)
        self._gradient = self.offer(Float64MultiArray, "gradient", RELIABLE_STREAM)
        self._gradient_writer = MessageWriter(Float64MultiArray(layout=_GRADIENT_LAYOUT, data=[0.0] * 9), 9)
        self._field_gradient = self.offer(PointCloud2, "field_gradient", RELIABLE_STREAM)
        self._field_gradient_writer = cloud_writer(point_cloud.FIELD_GRADIENT_COLUMNS, frame_id)
        self._marker = Shown(self, Marker, "center_marker", frame_id)

    def _take_samples(self, messages: list[bytes]) -> None:
        for rows in self._reader.read(messages):
            self._heard_s = time.monotonic()
            self._received += len(rows.values)
            if self._calibration is not None and self._correction is not None and len(rows.values):
                self._correct(self._calibration, self._correction, self._layout_of(rows.columns), rows)

    def _correct(self, calibration: Calibration, correction: Correction, layout: SampleLayout, rows: Rows) -> None:
        last = 1 + 3 * layout.sensor_count
        readings = rows.values[:, 1:last].reshape(len(rows.values), -1, 3)
        outputs = calibration.apply(readings)
        errors = [calibration.output_standard_errors] * len(outputs)
        has_scalar = "scalar" in layout.channels
        scalar = rows.values[:, last] if has_scalar else np.empty(0)
        codes = self._codes_of(correction, rows.values[:, 0], readings, outputs)
        if codes is not None:
            correction.partial.put(outputs, readings, codes)
            errors = correction.partial.standard_errors(codes)
            self._partial_count += int(np.count_nonzero(codes))
        if correction.takes_off:
            outputs[:], scalar = np.nan, scalar.copy()
            for run, batch in self._without_effects(correction, layout, self._in_run_time(rows, last), codes):
                self._left_in, outputs[run] = batch.left_in, batch.outputs
                if batch.scalar_T is not None:
                    scalar[run] = batch.scalar_T
                for index, own in zip(run, batch.standard_errors, strict=True):
                    errors[index] = own
        if has_scalar:
            self._lengths.append((outputs, scalar))
        self._newest_s = float(rows.values[-1, 0])
        self._corrected += len(outputs)
        centers = {}
        if codes is not None:
            for index in np.flatnonzero(codes).tolist():
                covariance = correction.partial.without(int(codes[index])).covariance[:3, :3].copy()
                np.fill_diagonal(covariance, errors[index][:3] ** 2)
                centers[index] = covariance.tobytes()
        self._publish(rows.stamps, outputs, errors, centers)

    def _codes_of(
        self, correction: Correction, time_s: FloatArray, readings: FloatArray, outputs: FloatArray
    ) -> IntArray | None:
        """Return which sensors are missing or contradict the others in each sample; None where all are sound."""
        missing = None
        if math.isnan(sum(outputs[:, 0].tolist())):  # a third of the time of isnan and any
            missing = missing_codes(readings)
            readings = correction.partial.filled(readings, missing)
        failing = correction.contradiction.codes_of(time_s, readings)
        if missing is None and not any(failing.tolist()):
            self._missing = self._failing = 0
            return None
        if new := sensors_of(int(np.bitwise_or.reduce(failing)) & ~self._told):
            names = " and ".join(map(str, new))
            self.get_logger().warning(f"sensor {names} contradicts the others at {time_s[failing > 0][0]:.2f} s")
            self._told |= int(np.bitwise_or.reduce(failing))
        self._missing, self._failing = 0 if missing is None else int(missing[-1]), int(failing[-1])
        return failing if missing is None else failing | missing

    def _in_run_time(self, rows: Rows, last: int) -> FloatArray:
        """Return the rows with the time of the run, so that effects with a memory keep it where stamps step back."""
        values = rows.values.copy()
        for stamp_ns, row in zip(map(from_stamp, rows.stamps), values, strict=True):
            self._run.begins_again(stamp_ns, row[1:last].tobytes())
            if (time_ns := self._run.time_ns(stamp_ns)) != stamp_ns:
                row[0] = time_ns / 1_000_000_000
        return values

    def _without_effects(
        self, correction: Correction, layout: SampleLayout, rows: FloatArray, codes: IntArray | None
    ) -> Iterator[tuple[IntArray, CorrectedBatch]]:
        """Yield the results of samples whose time rises, without effects, and which of the rows they are."""
        readings = rows[:, 1 : 1 + 3 * layout.sensor_count]
        if codes is not None:
            filled = correction.partial.filled(readings.reshape(len(rows), -1, 3), codes)
            readings[:] = filled.reshape(readings.shape)
        usable = np.flatnonzero(np.isfinite(readings).all(axis=1))
        for run in np.split(usable, np.flatnonzero(np.diff(rows[usable, 0]) <= 0) + 1):
            own, values = None if codes is None else codes[run], rows[run]
            try:
                if len(run):
                    known = layout.recording(np.where(np.isfinite(values), values, np.nan))
                    yield run, correction.correct(known, own)
            except InputError as problem:
                self.refuse("samples", str(problem))

    def _publish(
        self, stamps: list[bytes], outputs: FloatArray, errors: list[FloatArray], centers: Mapping[int, bytes]
    ) -> None:
        """Publish results, the covariance of the centre field from the standard errors where it is not given."""
        tells_center = self._center.get_subscription_count() > 0
        tells_gradient = self._array.has_gradient and self._gradient.get_subscription_count() > 0
        tells_both = self._field_gradient.get_subscription_count() > 0
        for index, (stamp, output, error) in enumerate(zip(stamps, outputs, errors, strict=True)):
            if tells_center:
                doubles = output[:3].tobytes() + (centers.get(index) or center_covariance(error).tobytes())
                self._center.publish(self._center_writer.message(stamp, doubles))
            if tells_gradient:
                doubles = output[_GRADIENT_ROW_MAJOR].tobytes()
                self._gradient.publish(self._gradient_writer.message(b"", doubles))
            if tells_both:
                doubles = output.tobytes() + error.tobytes()
                self._field_gradient.publish(self._field_gradient_writer.message(stamp, doubles))
        if self._marker.is_wanted() and np.isfinite(outputs[-1, :3]).all():
            self._marker.publisher.publish(field_marker(self._marker.header(from_stamp(stamps[-1])), outputs[-1, :3]))


_GRADIENT_ROW_MAJOR = np.array(point_cloud.GRADIENT_ROW_MAJOR)
_GRADIENT_LAYOUT = MultiArrayLayout(
    dim=[
        MultiArrayDimension(label=label, size=size, stride=stride)
        for label, size, stride in point_cloud.GRADIENT_DIMENSIONS
    ]
)
