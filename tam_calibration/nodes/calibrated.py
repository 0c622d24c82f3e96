"""What corrector and localizer share: the calibration of a file, newer ones over a topic, and their figures."""

from abc import abstractmethod
from collections.abc import Sequence
from pathlib import Path

from std_msgs.msg import String

from tam_calibration.correction.calibration import Calibration
from tam_calibration.messages.timeline import Run
from tam_calibration.model.data_sheet import DAY_S
from tam_calibration.model.exceptions import InputError
from tam_calibration.nodes.base import TamNode
from tam_calibration.nodes.node_parameters import SHARED, Rule
from tam_calibration.nodes.topics import LATCHED
from tam_calibration.results import calibration_from_yaml, read_calibration

CALIBRATED = (
    *SHARED,
    Rule(
        "calibration_file", "", "Calibration YAML; a newer one comes over `calibration`, or by this.", read_only=False
    ),
)


class CalibratedNode(TamNode):
    """A node that takes calibrations of its array.

    Parameters
    ----------
    name : str
        Name of the node.
    rules : sequence of Rule
        All its parameters, `CALIBRATED` among them.
    """

    def __init__(self, name: str, rules: Sequence[Rule]) -> None:
        super().__init__(name, rules)
        self._calibration: Calibration | None = None
        self._problem_of_calibration = ""
        self._run, self._heard_s = Run(), float("-inf")

    def take_calibrations(self) -> str:
        """Take that of the file, then each that comes; return what is to be said of the first at the start."""
        path: str = self.value("calibration_file")
        if path:
            if not Path(path).exists():
                raise InputError(
                    f"{path} does not exist: leave calibration_file out, then it comes over the topic calibration"
                )
            self._switch(read_calibration(Path(path)))
        self.on_change({"calibration_file": self._load})
        self.create_subscription(String, "calibration", self._take_calibration, LATCHED)
        return introduce(self._calibration, path, self.now_s)

    @abstractmethod
    def switch(self, calibration: Calibration) -> None:
        """Work with a calibration of the node's array from now on."""

    def _load(self, path: str) -> None:
        if path:
            self._adopt(read_calibration(Path(path)), path)

    def _take_calibration(self, message: String) -> None:
        """Take a calibration that can be used; the next sample is the first that it corrects."""
        topic = self.resolve_topic_name("calibration")
        try:
            self._adopt(calibration_from_yaml(message.data, topic), f"from {topic}")
        except InputError as problem:
            self._problem_of_calibration = str(problem)
            self.get_logger().warning(self._problem_of_calibration)

    def _adopt(self, calibration: Calibration, origin: str) -> None:
        self._switch(calibration)
        self.get_logger().info(introduce(calibration, origin, self.now_s))

    def _switch(self, calibration: Calibration) -> None:
        if not calibration.is_of(self._array):
            raise InputError("the calibration is of another array: choose the array_file that it was made with")
        self.switch(calibration)
        self._calibration, self._problem_of_calibration = calibration, ""


def introduce(calibration: Calibration | None, path: str, now_s: float) -> str:
    """Return the calibration that a node starts with, and its age; or where there is none yet.

    Parameters
    ----------
    calibration : Calibration or None
        That was loaded.
    path : str
        Where from; empty where no file is named.
    now_s : float
        Time of the node's clock, seconds.
    """
    if calibration is None:
        return f"no calibration: {path} is not there yet" if path else "no calibration"
    age_s = _age_s(calibration, now_s)
    age = "of unknown age" if age_s is None else f"{duration(age_s)} old"
    return f"calibration {path}, {age}: {calibration.quality}"


def figures(calibration: Calibration | None, now_s: float) -> dict[str, object]:
    """Return the figures of a calibration for /diagnostics (SI); nothing where there is none.

    Parameters
    ----------
    calibration : Calibration or None
        The one in use.
    now_s : float
        Present time on the clock of the recording's stamps, seconds; the age counts from the recording's end.
    """
    if calibration is None:
        return {"calibration": "none"}
    best, floor, age_s = calibration.best_residuals, calibration.floor, _age_s(calibration, now_s)
    return {
        "calibration": calibration.method,
        "quality": calibration.quality.grade,
        "calibration_samples": calibration.samples,
        "calibration_age_s": "unknown" if age_s is None else f"{age_s:.0f}",
        "tensor_residual_T_per_m": f"{best.tensor_rmse_T_per_m:.4g}",
        "tensor_floor_T_per_m": f"{floor.tensor_rmse_T_per_m:.4g}",
        "intensity_residual_T": f"{best.sensors_rms_T:.4g}",
        "intensity_floor_T": f"{floor.sensors_rms_T:.4g}",
    }


def _age_s(calibration: Calibration, now_s: float) -> float | None:
    """Return the time since the recording ended; None where its stamps are of another clock."""
    age = now_s - calibration.time_span_s[1]
    return age if 0 <= age < 20 * 365 * DAY_S else None


def duration(time_s: float) -> str:
    """Return a time in words: seconds, hours or days."""
    if time_s < 600:
        return f"{time_s:.0f} s"
    return f"{time_s / 3600:.1f} h" if time_s < 2 * DAY_S else f"{time_s / DAY_S:.0f} days"
