"""What the calibrator keeps of its run: samples, and a calibration that they update; a restart goes on with both."""

import os
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from threading import Lock

import numpy as np

from tam_calibration.correction.calibration import Calibration
from tam_calibration.correction.streaming import EffectRemoval
from tam_calibration.fit.prior import prior_of
from tam_calibration.live.live import ON_CHANGE, Change, Live, LiveState
from tam_calibration.messages.point_cloud import SampleLayout
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray, has_date
from tam_calibration.nodes.base import OK, WARN, TamNode
from tam_calibration.nodes.calibrated import duration
from tam_calibration.nodes.node_parameters import Rule
from tam_calibration.recordings.array_yaml import array_to_mapping
from tam_calibration.results import calibration_from_yaml, calibration_to_yaml
from tam_calibration.results.overwriting import name_aside, require_outside_bags
from tam_calibration.results.sample_file import SampleFile, SampleStore, read_live_state, write_live_state

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
        return f"goes on with {len(samples)} samples of {self._file.path}, the last of {duration(age_s)} ago"

    def save(self) -> None:
        """Save what has changed."""
        generation, samples = self.store.samples()
        if self.store.discarded:
            lost = f"{self.store.discarded} samples of an earlier run are discarded"
            self._node.get_logger().info(f"{lost}: the new stamps do not go on from them")
            self.store.discarded = 0
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


UPDATED = (
    Rule("update", False, "Whether the calibration is kept up to date with the samples as they arrive."),
    Rule(
        "on_change",
        "tell",
        "When a sensor has changed: tell, learn it anew, or restore the stored calibration.",
        choices=ON_CHANGE,
        read_only=False,
    ),
)


class LiveUpdate:
    """Keeps a calibration up to date where the parameter ``update`` says so.

    Parameters
    ----------
    node : TamNode
        Whose parameters `UPDATED` say what is done.
    array : Array
        That the samples are of.
    samples_file : Path or None
        Beside which the state is kept; None where nothing is kept.
    publish : callable
        Takes a calibration that has changed.
    """

    def __init__(
        self, node: TamNode, array: Array, samples_file: Path | None, publish: Callable[[Calibration], None]
    ) -> None:
        self._node, self._array, self._publish = node, array, publish
        self._path = samples_file and samples_file.with_name(samples_file.name + ".live")
        self._layout = SampleLayout.whole(array.sensor_count, array.further_channels)
        self._lock = Lock()
        self._is_on = bool(node.value("update"))
        self._stored: Calibration | None = None
        self._text = ""
        self._live: Live | None = None
        self._removal: EffectRemoval | None = None
        self._saved: LiveState | None = None
        self._changes: tuple[Change, ...] = ()
        self._told = 0
        self.problem = self._unkept = ""

    def go_on(self, stored: Calibration | None) -> Calibration | None:
        """Take up what a process before this one learned, and return what it published last; else what is stored.

        Parameters
        ----------
        stored : Calibration or None
            The calibration that the node was given.
        """
        if not self._is_on:
            return stored
        kept = self._read(stored)
        if kept is None:
            self._stored = stored
            return stored
        calibration, state = kept
        self._begin(calibration, state.recursion.now.time_s, state)
        if self._live is None:
            return self._stored
        self._node.get_logger().info(f"goes on with what was learned from {state.learned} samples, in {self._path}")
        return self._live.calibration

    def begin(self, stored: Calibration) -> None:
        """Begin anew, with the next sample, with a calibration that was fitted; the changes before it stay known."""
        with self._lock:
            self._changes = self._known_changes
            self._live, self._stored, self.problem = None, stored, ""

    @property
    def _known_changes(self) -> tuple[Change, ...]:
        return self._changes if self._live is None else self._live.state.changes

    def since_change(self, recording: Recording) -> tuple[Recording, str]:
        """Return the samples of the sensors as they are, and a remark if others before a change are left out."""
        last = next((change for change in reversed(self._known_changes) if not change.is_of_field), None)
        is_since = recording.time_s >= (-np.inf if last is None else last.since_s)
        if last is None or is_since.all() or not is_since.any():  # without a later sample it was in another run
            return recording, ""
        count = np.count_nonzero(~is_since)
        return recording.take(is_since), f"{count} samples before {_when(last.since_s)} are left out: {last.sentence}"

    def add(self, rows: FloatArray) -> None:
        """Take whole samples (n, columns of the whole layout), and publish the calibration where it has changed."""
        if not (self._is_on and len(rows)):
            return
        with self._lock:
            if self._live is None and self._stored is not None and not self.problem:
                self._begin(self._stored, float(rows[0, 0]), None)
            live = self._live
            if live is None:
                return
            live.on_change = self._node.value("on_change")
            live.add(*self._rows_without_effects(rows))
            news = live.news()
        for change in live.state.changes[self._told :]:
            self._node.get_logger().warning(f"{_when(change.since_s)}: {change.sentence}")
        self._told = len(live.state.changes)
        if news is not None:
            self._publish(news)

    def save(self) -> None:
        """Save what has changed."""
        live = self._live
        if live is None or self._path is None or live.state is self._saved:
            return
        state = live.state
        try:
            write_live_state(self._path, state, self._text)
        except (InputError, OSError) as problem:
            if not self._unkept:
                self._node.get_logger().warning(f"what is learned is not kept: {problem}")
            self._unkept = f"what is learned is not kept: {problem}"
        else:
            self._saved, self._unkept = state, ""

    def sentence(self) -> str:
        """Return what it does, for people; empty where it is off."""
        if not self._is_on:
            return ""
        if self._live is None:
            return self.problem or "updates once there is a calibration"
        told = "; ".join(filter(None, (self._live.sentence, self.problem, self._unkept)))
        changes = self._live.state.changes
        return f"{told}; {_when(changes[-1].since_s)}: {changes[-1].sentence}" if changes else told

    def figures(self) -> dict[str, object]:
        """Return the figures for /diagnostics; nothing where it is off."""
        if self._live is None:
            return {}
        state = self._live.state
        last = state.changes[-1] if state.changes else None
        return {
            "learned": state.learned,
            "paused_by": state.paused_by,
            "changes": len(state.changes),
            "changed_law": last.law if last else "",
            "changed_sensor": last.sensor if last else "",
            "changed_parameters": " or ".join(last.parameters) if last else "",
        }

    @property
    def level(self) -> bytes:
        """Level of the health: a warning while nothing is learned."""
        is_paused = self._live is not None and self._live.state.paused_by
        level: bytes = WARN if self.problem or self._unkept or is_paused else OK
        return level

    def _begin(self, stored: Calibration, time_s: float, state: LiveState | None) -> None:
        self._stored, self._text = stored, calibration_to_yaml(stored)
        self._told = len(state.changes if state else self._changes)
        try:
            self._removal = EffectRemoval(stored)
            prior = prior_of(stored, time_s, None, self._array.change_rates)
            self._live = Live(prior, self._node.value("on_change"), state)
            if state is None:
                self._live.state = replace(self._live.state, changes=self._changes)
        except InputError as problem:
            self.problem = f"not updated: {problem}"

    def _rows_without_effects(self, rows: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """Return samples as `Live.add` takes them, without the effects; none where stamps step back."""
        last = 1 + 3 * self._array.sensor_count
        if self._stored is None or not self._stored.effects or self._removal is None:
            return rows[:, : last + 2], self._layout.channel(rows, "gyroscope")
        try:
            recording = self._removal.of(self._layout.recording(rows))
        except InputError:
            return rows[:0, : last + 2], None
        count = recording.sample_count
        unknown = np.full(count, np.nan)
        channels = [unknown if each is None else each for each in (recording.scalar_T, recording.temperature_C)]
        whole = np.column_stack([recording.time_s, recording.readings_T.reshape(count, -1), *channels])
        return whole, recording.angular_velocity_rad_s

    def _read(self, stored: Calibration | None) -> tuple[Calibration, LiveState] | None:
        """Return what is on disk; if it is damaged or of another array or calibration it is set aside."""
        if self._path is None or not os.path.lexists(self._path):
            return None
        try:
            state, text = read_live_state(self._path, self._array.sensor_count)
            calibration = calibration_from_yaml(text, str(self._path))
            if not calibration.is_of(self._array):
                raise InputError(f"{self._path} is of another array")
            if stored is not None and calibration_to_yaml(stored) != calibration_to_yaml(calibration):
                raise InputError(f"{self._path} was learned with another calibration than calibration_file")
        except InputError as problem:
            try:
                moved = f"it is now {self._path.rename(name_aside(self._path))}"
            except OSError as why:
                moved = f"it cannot be renamed ({why.strerror})"
            self._node.get_logger().warning(f"{problem}: {moved}, and the update begins anew")
            return None
        return calibration, state


def _when(stamp_s: float) -> str:
    if has_date(stamp_s):
        return f"{datetime.fromtimestamp(stamp_s, UTC):%Y-%m-%d %H:%M:%S} UTC"
    return f"at {stamp_s:.0f} s"
