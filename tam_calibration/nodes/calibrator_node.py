"""The calibrator node: stores samples, fits or diagnoses them when asked, and hands on the calibration."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Event, Lock
from traceback import format_exc
from typing import Any

import numpy as np
from rclpy.service import Service
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from tam_calibration.correction.calibration import Calibration
from tam_calibration.files import calibration_to_yaml, read_calibration, write_calibration
from tam_calibration.files.results_json import write_gap
from tam_calibration.fit import DEFAULT_METHOD, METHODS, calibrate
from tam_calibration.gap import diagnose
from tam_calibration.gap.result import Gap
from tam_calibration.messages.point_cloud import SampleLayout
from tam_calibration.messages.run import Run
from tam_calibration.messages.timeline import Timeline
from tam_calibration.messages.usage import Usage
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray
from tam_calibration.nodes.base import ERROR, LATCHED, OK, RELIABLE_STREAM, STALE, WARN, Health, TamNode
from tam_calibration.nodes.calibration_figures import describe, figures, introduce
from tam_calibration.nodes.cloud import CloudReader, Rows, from_stamp, layout_of
from tam_calibration.nodes.node_parameters import ARRAY_FILE, Rule, array_of


class SampleStore:
    """The samples since the last start over.

    When it is full every second sample is given up, and only every second new one is taken, so that the whole
    run stays covered. Its time goes on where stamps step back; a recording that is played once more starts it over. One
    thread may add while another asks for the recording.

    Parameters
    ----------
    layout : SampleLayout
        Of the samples.
    capacity : int
        Greatest number of samples.
    """

    def __init__(self, layout: SampleLayout, capacity: int) -> None:
        self.layout, self._capacity = layout, capacity
        self._lock = Lock()
        self.start_over()

    def __len__(self) -> int:
        """Return the number of stored samples."""
        return len(self._rows)

    def start_over(self) -> None:
        """Forget all samples."""
        with self._lock:
            self._begin()

    def _begin(self) -> None:
        self._rows: list[FloatArray] = []
        self._stride, self._seen = 1, 0
        self._run, self._timeline = Run(), Timeline[FloatArray](disorder_ns=0)

    def add(self, stamp_ns: int, row: FloatArray) -> None:
        """Add one sample.

        Parameters
        ----------
        stamp_ns : int
            Its stamp, nanoseconds.
        row : (columns,) array
            The values of ``layout.columns``, SI, the first of which is the time, seconds.
        """
        with self._lock:
            for believed_ns, believed in self._timeline.take(stamp_ns, row):
                self._store(believed_ns, believed)

    def _store(self, stamp_ns: int, row: FloatArray) -> None:
        readings = row[1 : 1 + 3 * self.layout.sensor_count].tobytes()
        if self._run.begins_again(stamp_ns, readings):
            self._rows, self._stride, self._seen = [], 1, 0
        time_ns = self._run.time_ns(stamp_ns)
        if self._seen % self._stride == 0:
            self._rows.append(row if time_ns == stamp_ns else np.append(time_ns / 1_000_000_000, row[1:]))
        self._seen += 1
        if len(self._rows) == self._capacity:
            self._rows, self._stride = self._rows[::2], 2 * self._stride

    def recording(self) -> Recording:
        """Return the stored samples.

        Raises
        ------
        InputError
            When there is none, or they are no recording.
        """
        with self._lock:
            rows = self._rows.copy()
        if not rows:
            raise InputError(
                "no samples are stored: check in /diagnostics that the collector runs and every sensor publishes"
            )
        return self.layout.recording(np.array(rows))


RULES = (
    ARRAY_FILE,
    Rule("method", DEFAULT_METHOD, "Method of the fit.", choices=tuple(METHODS), read_only=False),
    Rule(
        "calibration_file",
        "",
        "Calibration YAML: loaded at the start where it exists, written by ~/save.",
        read_only=False,
    ),
    Rule("gap_file", "", "Gap JSON: written by ~/diagnose where a file is named.", read_only=False),
    Rule("gap_report_file", "", "HTML page: written by ~/diagnose where a file is named.", read_only=False),
    Rule("max_samples", 200_000, "Samples kept; when full, every second one is given up.", bounds=(1000, 10_000_000)),
)


_TURN_S = 0.05
"""Time from one look for samples and requests to the next."""

_ANSWER_S = 2.0
"""Longest wait for the collector's answer."""


class Calibrator(TamNode):
    """Fits the stored samples on ~/calibrate and publishes `calibration`, latched; diagnoses them on ~/diagnose.

    Its services have a thread of their own, so that samples are stored while one of them works. rclpy's executor with
    threads would do the same at the cost of a core.
    """

    def __init__(self) -> None:
        self._worked: list[Service] = []
        super().__init__("calibrator", RULES)
        self._array = array_of(self)
        self._store = SampleStore(SampleLayout.whole(self._array.sensor_count), self.value("max_samples"))
        self._problem = ""
        self._calibration: Calibration | None = None
        self._gap: Gap | None = None
        self._publisher = self.create_publisher(String, "calibration", LATCHED)
        self._load()
        self._reader = CloudReader(self._refuse_samples)
        self.listen_in_turns([(PointCloud2, "samples", self._take)], _TURN_S, RELIABLE_STREAM)
        actions = {"calibrate": self._calibrate, "diagnose": self._diagnose, "save": self._save}
        self._worked = [
            self.create_service(Trigger, f"~/{name}", self._answering(action)) for name, action in actions.items()
        ]
        self._collector = self.create_client(Trigger, "collector/usage")
        self._worker = ThreadPoolExecutor(max_workers=1)
        self.create_steady_timer(_TURN_S, self._take_requests)
        told = introduce(self._calibration, self.value("calibration_file"), self.now_s)
        self.say_start(told, "waits for samples")

    @property
    def services(self) -> Iterator[Service]:
        """The services that the executor answers: not those that have a thread of their own."""
        yield from (each for each in super().services if each not in self._worked)

    def health(self) -> Health:
        """Return what is stored, how good the calibration is, and what the last diagnosis found."""
        stored = f"{len(self._store)} samples stored"
        if self._problem:
            level, message = ERROR, self._problem
        elif self._calibration is not None:
            level, message = OK, f"{stored}; {describe(self._calibration)}"
        else:
            level, message = (OK, f"{stored}; no calibration yet") if len(self._store) else (STALE, "no samples yet")
        gap = self._gap
        if gap is not None:
            level, message = max(level, _level_of(gap)), f"{message}; {gap.statement}"
        values = {"samples": len(self._store), **figures(self._calibration, self.now_s), **_figures_of(gap)}
        return Health(level, message, values)

    def _load(self) -> None:
        path = Path(self.value("calibration_file"))
        if not path.is_file():
            return
        calibration = read_calibration(path)
        if not calibration.is_of(self._array):
            raise InputError(f"{path} is the calibration of another array: change calibration_file or array_file")
        self._hand_on(calibration)

    def _take(self, messages: list[bytes]) -> None:
        self._problem = ""
        for rows in self._reader.read(messages):
            try:
                layout_of(rows.columns, self._array.sensor_count)
            except InputError as problem:
                self._refuse_samples(str(problem))
                continue
            if not len(rows.values):
                self._store.start_over()
            self._add(rows)

    def _add(self, rows: Rows) -> None:
        """Store the rows that are samples: one that is not is counted and costs no other."""
        values = self._store.layout.widened(rows.columns, rows.values)
        for stamp, row, is_sample in zip(rows.stamps, values, self._store.layout.are_samples(values), strict=True):
            if is_sample:
                self._store.add(from_stamp(stamp), row)
            else:
                self.refuse("samples", "a value is infinite, a reading is NaN, or an attitude is four zeros")

    def _refuse_samples(self, problem: str) -> None:
        self._problem = problem
        self.refuse("samples", problem)

    def _take_requests(self) -> None:
        for service in self._worked:
            with service.handle:
                request, header = service.handle.service_take_request(Trigger.Request)
            if header is not None:
                self._worker.submit(self._respond, service, request, header)

    def _respond(self, service: Service, request: Trigger.Request, header: Any) -> None:
        service.send_response(service.callback(request, Trigger.Response()), header)

    def _answering(self, action: Callable[[], str]) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
        def answer(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                response.message, response.success = action(), True
                self.get_logger().info(response.message)
            except (InputError, Refused, OSError) as problem:
                response.message, response.success = " ".join(str(problem).split()), False
                self.get_logger().warning(response.message)
            except Exception as defect:  # a defect of a fit must not cost the mission its samples
                response.message, response.success = f"a defect of this software: {defect!r}", False
                self.get_logger().error(f"{response.message}\n{format_exc()}")
            return response

        return answer

    def _calibrate(self) -> str:
        usage = self._usage()
        warnings = usage.warnings() if usage else ()
        samples = self._store.recording()
        fitted = usage.with_each_reading_once(samples) if usage else samples
        calibration = calibrate(fitted, self._array, self.value("method"))
        if usage:
            warnings += usage.interpolation_warnings(samples, calibration.array.vector_noise_T)
        calibration = replace(calibration, warnings=(*warnings, *calibration.warnings))
        self._hand_on(calibration)
        told = "; ".join([*([] if warnings else [_in_words(usage)]), *calibration.warnings])
        return f"{describe(calibration)}; {calibration.method} on {calibration.samples} samples; {told}"

    def _diagnose(self) -> str:
        usage = self._usage()
        remarks = usage.remarks() if usage else ()
        gap = diagnose(self._store.recording(), self._array, progress=self._go_on)
        self._gap = replace(gap, remarks=(*remarks, *gap.remarks))
        written = self._write(self._gap)
        return " ".join([gap.headline, *(remarks or [f"{_in_words(usage)}."])]) + written

    def _usage(self) -> Usage | None:
        """Ask the collector how many of sensor 1's samples it used; None where none answers."""
        if not self._collector.service_is_ready():
            return None
        answered = Event()
        future = self._collector.call_async(Trigger.Request())
        future.add_done_callback(lambda _: answered.set())
        return Usage.from_json(future.result().message) if answered.wait(_ANSWER_S) else None

    def _go_on(self, stage: str, done: float) -> None:
        """Give up a diagnosis when the node shall end."""
        if not self.context.ok():
            raise Refused(f"the node ended while it was {stage}")

    def _write(self, gap: Gap) -> str:
        from tam_calibration.report.gap_report import write_gap_report

        paths: list[str] = []
        for name, write in (("gap_file", write_gap), ("gap_report_file", write_gap_report)):
            if path := self.value(name):
                write(Path(path), gap)
                paths.append(path)
        return f"; written to {' and '.join(paths)}" if paths else ""

    def _save(self) -> str:
        if self._calibration is None:
            raise Refused("there is no calibration to save: call calibrator/calibrate first")
        path: str = self.value("calibration_file")
        if not path:
            raise Refused(f"no file is named: set the parameter calibration_file of {self.get_name()}")
        write_calibration(Path(path), self._calibration)
        return f"saved to {path}"

    def _hand_on(self, calibration: Calibration) -> None:
        self._calibration = calibration
        self._publisher.publish(String(data=calibration_to_yaml(calibration)))


def _in_words(usage: Usage | None) -> str:
    return str(usage) if usage else "no collector tells how many samples of sensor 1 were used"


def _level_of(gap: Gap) -> bytes:
    """Warn of a gap that is there, whether or not its cause is known."""
    level: bytes = OK if gap.verdict in ("no_gap", "not_identifiable") else WARN
    return level


def _figures_of(gap: Gap | None) -> dict[str, object]:
    """Return the figures of a diagnosis for /diagnostics (SI)."""
    if gap is None:
        return {"gap": "not diagnosed"}
    return {
        "gap": gap.verdict,
        "gap_causes": " ".join(cause.fitted.effect for cause in gap.causes),
        "set_95": " ".join(gap.set_95),
        "gap_samples": len(gap.residue.time_s),
        "gap_before_T": f"{gap.size.before_T:.4g}",
        "gap_after_T": f"{gap.size.after_T:.4g}",
        "gap_floor_T": f"{gap.size.floor_T:.4g}",
    }
