"""The samples of the calibrator's run, in memory and on disk, so that one that is started again goes on."""

import os
from dataclasses import replace
from pathlib import Path

from tam_calibration.messages.point_cloud import SampleLayout
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.nodes.base import TamNode
from tam_calibration.nodes.node_parameters import Rule
from tam_calibration.recordings.array_yaml import array_to_mapping
from tam_calibration.results.overwriting import require_outside_bags
from tam_calibration.results.sample_file import SampleFile, SampleStore

SAVE_S = 1.0
"""Time from one saving to the next, seconds: no more is lost when the process is killed."""

KEPT = (
    Rule("max_samples", 200_000, "Samples kept; when full, every second one is given up.", bounds=(1000, 10_000_000)),
    Rule(
        "samples_file",
        "",
        "File in which samples are kept for a restart; empty: in ~/.ros/tam_calibration; none: nowhere.",
    ),
)


class KeptSamples:
    """The store of a node and its file.

    What hinders the file hinders nothing else, and is tried again with every saving.

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
    """

    def __init__(self, node: TamNode, array: Array) -> None:
        self._node, self.saved = node, 0
        self._found = self._hindrance = ""
        self._file: SampleFile | None = None
        self._on_disk: int | None = None
        self.store = SampleStore(
            SampleLayout.whole(array.sensor_count, array.further_channels), node.value("max_samples")
        )
        try:
            self.remark = self._go_on(node.value("samples_file"), array)
        except InputError as problem:
            self.remark = str(problem)
            self._found = "" if self._file else self.remark
        self.save()

    @property
    def path(self) -> Path | None:
        """Path of the file; None where nothing is kept."""
        return self._file.path if self._file else None

    @property
    def problem(self) -> str:
        """What was wrong with the file, and how many samples are not on disk, and why; empty where all is well."""
        unkept = len(self.store) - self.saved
        told = f"{unkept} samples are not on disk, which is tried again: {self._hindrance}" if self._hindrance else ""
        return "; ".join(filter(None, (self._found, told)))

    def _go_on(self, given: str, array: Array) -> str:
        if given == "none":
            return "samples are not kept for a restart"
        # By domain and name of the node, in ROS's own folder where no file is named.
        name = f"{self._node.context.get_domain_id()}{self._node.get_fully_qualified_name()}"
        own = Path("tam_calibration", f"{name.replace('/', '.')}.samples")
        path = Path(given) if given else Path(os.environ.get("ROS_HOME") or Path.home() / ".ros", own)
        require_outside_bags(path)
        columns = list(self.store.layout.columns)
        shaped_by = array_to_mapping(replace(array, vector_noise_T=None, scalar_noise_T=None))
        self._file = SampleFile(path, name, {"array": shaped_by, "columns": columns}, len(columns))
        samples, is_whole = self._file.read()
        if self._file.remark:
            self._found = self._file.remark
            self._node.get_logger().warning(self._found)
        if is_whole:
            self._on_disk, self.saved = self.store.samples()[0], len(samples)
        if not samples:
            return f"keeps samples in {self._file.path}"
        self.store.resume(samples)
        age_s = self._node.now_s - samples[-1].stamp_ns / 1e9
        return f"goes on with {len(samples)} samples of {self._file.path}, the last of {age_s:.0f} s ago"

    def save(self) -> None:
        """Save what has changed."""
        generation, samples = self.store.samples()
        if self._file is None or (generation, len(samples)) == (self._on_disk, self.saved):
            return
        try:
            self._file.save(samples, self.saved if generation == self._on_disk else 0)
        except InputError as problem:
            if not self._hindrance:
                self._node.get_logger().warning(str(problem))
            self._hindrance = str(problem)
            return
        if self._hindrance:
            self._node.get_logger().info(f"samples are kept in {self._file.path} again")
        self._on_disk, self.saved, self._hindrance = generation, len(samples), ""
