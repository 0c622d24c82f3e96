"""What corrector and localizer share: a calibration that comes from a file, and newer ones over a topic."""

from abc import abstractmethod
from collections.abc import Sequence
from pathlib import Path

from std_msgs.msg import String

from tam_calibration.correction.calibration import Calibration
from tam_calibration.messages.run import Run
from tam_calibration.model.exceptions import InputError
from tam_calibration.nodes.base import TamNode
from tam_calibration.nodes.calibration_figures import introduce
from tam_calibration.nodes.listening import LATCHED
from tam_calibration.nodes.node_parameters import ARRAY_FILE, FRAME_ID, Rule, array_of
from tam_calibration.results import calibration_from_yaml, read_calibration

CALIBRATED = (
    ARRAY_FILE,
    FRAME_ID,
    Rule(
        "calibration_file", "", "Calibration YAML; a newer one comes over `calibration`, or by this.", read_only=False
    ),
)

SILENCE_S = 2.0
"""Without samples, from which the status says so: two periods of the status, so that one late sample is no silence."""


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
        self._array = array_of(self)
        self._calibration: Calibration | None = None
        self._problem_of_calibration = ""
        self._run, self._heard_s = Run(), float("-inf")

    def take_calibrations(self) -> str:
        """Take that of the file, then each that comes; return what is to be said of the first at the start."""
        path: str = self.value("calibration_file")
        self._load(path)
        self.on_change({"calibration_file": self._load})
        self.create_subscription(String, "calibration", self._take_calibration, LATCHED)
        return introduce(self._calibration, path, self.now_s)

    @abstractmethod
    def switch(self, calibration: Calibration) -> None:
        """Work with a calibration of the node's array from now on."""

    def _load(self, path: str) -> None:
        if path:
            self._switch(read_calibration(Path(path)))

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
        self.switch(calibration)
        self._calibration, self._problem_of_calibration = calibration, ""
