"""The calibrator node: stores samples, fits when asked, and hands on the calibration."""

from collections.abc import Callable
from pathlib import Path
from traceback import format_exc

from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from tam_calibration.calibration import Calibration
from tam_calibration.files import calibration_to_yaml, read_calibration, write_calibration
from tam_calibration.fit import DEFAULT_METHOD, METHODS, calibrate
from tam_calibration.nodes.base import ERROR, LATCHED, OK, RELIABLE_STREAM, STALE, Health, TamNode
from tam_calibration.nodes.cloud import read_cloud
from tam_calibration.nodes.parameters import ARRAY_FILE, Rule, array_of
from tam_calibration.nodes.quality import describe, figures
from tam_calibration.nodes.signals import Startup
from tam_calibration.nodes.spinning import spin_node
from tam_calibration.nodes.store import SampleStore
from tam_calibration.problems import InputError, Refused

RULES = (
    ARRAY_FILE,
    Rule("method", DEFAULT_METHOD, "Method of the fit.", choices=tuple(METHODS), read_only=False),
    Rule(
        "calibration_file",
        "",
        "Calibration YAML: loaded at the start where it exists, written by ~/save.",
        read_only=False,
    ),
    Rule("max_samples", 200_000, "Samples kept; when full, every second one is given up.", bounds=(1000, 10_000_000)),
)


class Calibrator(TamNode):
    """Fits the stored samples on ~/calibrate and publishes `calibration`, latched."""

    def __init__(self) -> None:
        super().__init__("calibrator", RULES)
        self._array = array_of(self)
        self._store = SampleStore(self.value("max_samples"))
        self._problem = ""
        self._calibration: Calibration | None = None
        self._publisher = self.create_publisher(String, "calibration", LATCHED)
        self._load()
        self.create_subscription(PointCloud2, "samples", self._take, RELIABLE_STREAM)
        self.create_service(Trigger, "~/calibrate", self._answering(self._calibrate))
        self.create_service(Trigger, "~/save", self._answering(self._save))

    def health(self) -> Health:
        """Return what is stored, and how good the calibration is."""
        stored = f"{len(self._store)} samples stored"
        if self._problem:
            level, message = ERROR, self._problem
        elif self._calibration is not None:
            level, message = OK, f"{stored}; {describe(self._calibration)}"
        else:
            level, message = (OK, f"{stored}; no calibration yet") if len(self._store) else (STALE, "no samples yet")
        now_s = self.get_clock().now().nanoseconds / 1e9
        return Health(level, message, {"samples": len(self._store), **figures(self._calibration, now_s)})

    def _load(self) -> None:
        path = Path(self.value("calibration_file"))
        if not path.is_file():
            return
        calibration = read_calibration(path)
        if not calibration.array.has_geometry_of(self._array):
            raise InputError(f"{path} is the calibration of another array: change calibration_file or array_file")
        self._hand_on(calibration)

    def _take(self, cloud: PointCloud2) -> None:
        try:
            columns, rows = read_cloud(cloud)
        except InputError as problem:
            self._problem = str(problem)
            return
        self._problem = ""
        if not len(rows):
            self._store.start_over()
        for row in rows:
            self._store.add(columns, row)

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
        calibration = calibrate(self._store.recording(), self._array, self.value("method"))
        self._hand_on(calibration)
        warnings = "".join(f"; {warning}" for warning in calibration.warnings)
        return f"{describe(calibration)}; {calibration.method} on {calibration.samples} samples{warnings}"

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


def spin(startup: Startup) -> None:
    """Run the calibrator until it is told to end."""
    spin_node(startup, Calibrator, SingleThreadedExecutor)
