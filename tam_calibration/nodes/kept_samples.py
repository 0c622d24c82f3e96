"""The samples of the calibrator's run, in memory and on disk, so that one that is started again goes on."""

import os
from dataclasses import replace
from pathlib import Path

from tam_calibration.files.text_files import to_json
from tam_calibration.messages.point_cloud import SampleLayout
from tam_calibration.messages.sample_store import SampleStore
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.nodes.base import TamNode
from tam_calibration.nodes.node_parameters import Rule
from tam_calibration.recordings.array_yaml import array_to_mapping
from tam_calibration.results.overwriting import require_outside_bags
from tam_calibration.results.sample_file import SampleFile

SAVE_S = 1.0
"""Time from one saving to the next, seconds: no more is lost when the process is killed."""

_NOWHERE = "none"

KEPT = (
    Rule("max_samples", 200_000, "Samples kept; when full, every second one is given up.", bounds=(1000, 10_000_000)),
    Rule(
        "samples_file",
        "",
        "SQLite file in which samples are kept for a restart; empty: in ~/.ros/tam_calibration; none: nowhere.",
    ),
)


class KeptSamples:
    """The store of a node and its file.

    Parameters
    ----------
    node : TamNode
        Whose parameters `KEPT` say how many samples are kept, and where.
    array : Array
        That the samples are of.

    Attributes
    ----------
    store : SampleStore
        With the samples that a process before this one left.
    remark : str
        On these, for people.
    saved : int
        How many samples are on disk.
    path : Path or None
        Of the file; None where nothing is kept.
    problem : str
        Why samples are not kept on disk; empty where they are, or shall not be.
    """

    def __init__(self, node: TamNode, array: Array) -> None:
        self._node, self.problem, self.saved = node, "", 0
        self._file: SampleFile | None = None
        self.path: Path | None = None
        self.store = SampleStore(
            SampleLayout.whole(array.sensor_count, array.further_channels), node.value("max_samples")
        )
        try:
            self.remark = self._go_on(node.value("samples_file"), array)
        except InputError as problem:
            self._give_up(problem)
            self.remark = self.problem

    def _go_on(self, given: str, array: Array) -> str:
        if given == _NOWHERE:
            return "samples are not kept for a restart"
        path = Path(given) if given else self._default_path()
        require_outside_bags(path)
        shaped_by = array_to_mapping(replace(array, vector_noise_T=None, scalar_noise_T=None))
        self._file = SampleFile(path, to_json({"array": shaped_by, "columns": list(self.store.layout.columns)}))
        if self._file.set_aside:
            self._node.get_logger().warning(f"{path} held no samples of this array: it is now {self._file.set_aside}")
        samples = self._file.read()
        self.path = path
        if not samples:
            return f"keeps samples in {path}"
        self.store.resume(samples)
        self.saved = len(samples)
        age_s = self._node.now_s - samples[-1].stamp_ns / 1e9
        return f"goes on with {len(samples)} samples of {path}, the last of {age_s:.0f} s ago"

    def _default_path(self) -> Path:
        """Return a place in ROS's own folder, by domain and name of the node."""
        home = os.environ.get("ROS_HOME") or Path.home() / ".ros"
        name = self._node.get_fully_qualified_name().replace("/", ".")
        return Path(home, "tam_calibration", f"{self._node.context.get_domain_id()}{name}.samples")

    def save(self) -> None:
        """Save what has changed."""
        changed = self.store.unsaved()
        if self._file and (changed.begins or changed.samples):
            try:
                self._file.save(changed)
            except InputError as problem:
                self._give_up(problem)
            else:
                self.saved = len(self.store)

    def _give_up(self, problem: InputError) -> None:
        self._file, self.problem = None, str(problem)
        self._node.get_logger().warning(self.problem)

    def close(self) -> None:
        """Save what is not saved yet, and end writing."""
        self.save()
        if self._file:
            self._file.close()
