"""The calibrator node: stores samples, fits or diagnoses them when asked, hands on the calibration."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Event

from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from tam_calibration.correction.calibration import Calibration
from tam_calibration.files.text_files import check_writable
from tam_calibration.fit import DEFAULT_METHOD, METHODS, calibrate
from tam_calibration.fit.consistency import naming_causes
from tam_calibration.gap import diagnose
from tam_calibration.gap.calibration_with_effects import explained
from tam_calibration.gap.result import Gap
from tam_calibration.integrity.fault import names_in, require_names
from tam_calibration.messages.point_cloud import layout_of
from tam_calibration.messages.samples import NO_USAGE, Usage
from tam_calibration.model.exceptions import InputError, Refused, adding
from tam_calibration.model.recording import FEWEST_SAMPLES
from tam_calibration.nodes.base import ERROR, OK, STALE, WARN, Health, TamNode, Work
from tam_calibration.nodes.calibrated import figures, introduce
from tam_calibration.nodes.calibrator_state import KEPT, SAVE_S, UPDATED, KeptSamples, LiveUpdate
from tam_calibration.nodes.node_parameters import SHARED, Rule
from tam_calibration.nodes.topics import LATCHED, RELIABLE_STREAM, CloudReader, Rows, from_stamp
from tam_calibration.recordings.fit_input import fit_with_usage
from tam_calibration.report.calibration_rows import update_sentences
from tam_calibration.results import calibration_to_yaml, read_calibration, write_calibration
from tam_calibration.results.overwriting import require_separate
from tam_calibration.results.results_json import write_gap

RULES = (
    *SHARED,
    Rule("method", DEFAULT_METHOD, "Method of the fit.", choices=tuple(METHODS), read_only=False),
    Rule(
        "calibration_file",
        "",
        "Calibration YAML: loaded at the start where it exists, written by ~/save.",
        read_only=False,
    ),
    Rule("gap_file", "", "Gap JSON: written by ~/diagnose where a file is named.", read_only=False),
    Rule("accept", "", "Findings that refuse no calibration, separated by commas.", read_only=False),
    Rule("autosave", False, "Whether ~/calibrate writes calibration_file too.", read_only=False),
    Rule(
        "prior",
        False,
        "Whether ~/calibrate takes the calibration that was loaded from calibration_file for its prior.",
        read_only=False,
    ),
    *KEPT,
    *UPDATED,
)

_WRITTEN = ("calibration_file", "gap_file")
"""Parameters that name a file to write."""


class Calibrator(TamNode):
    """Fits the stored samples on ~/calibrate and publishes `calibration`, latched; diagnoses them on ~/diagnose.

    Samples are stored while it works, and kept on disk for the node that takes its place when it is killed.
    """

    def __init__(self) -> None:
        super().__init__("calibrator", RULES)
        self._kept = KeptSamples(self, self._array)
        self._store = self._kept.store
        self._partial = 0
        self._calibration: Calibration | None = None
        self._gap: Gap | None = None
        self._publisher = self.create_publisher(String, "calibration", LATCHED)
        self._live = LiveUpdate(self, self._array, self._kept.path, self._publish)
        self._loaded = self._stored()
        if calibration := self._live.go_on(self._loaded):
            self._publish(calibration)
        check = partial(layout_of, sensor_count=self._array.sensor_count)
        self._reader = CloudReader(partial(self.refuse, "samples"), check)
        self.listen_in_turns([(PointCloud2, "samples", self._take)], period_s=0.05, quality=RELIABLE_STREAM)
        self._work = Work()
        self.serve("calibrate", partial(self._logged, self._calibrate), self._work)
        self.serve("diagnose", partial(self._logged, self._diagnose), self._work)
        self.serve("save", partial(self._logged, self._save))
        self._collector = self.create_client(Trigger, "collector/usage")
        self.create_steady_timer(SAVE_S, self._kept.save)
        self.create_steady_timer(SAVE_S, self._live.save)
        _check_accept(self.value("accept"))
        self.on_change({**dict.fromkeys(_WRITTEN, check_writable), "accept": _check_accept})
        told = introduce(self._calibration, self.value("calibration_file"), self.now_s)
        self.say_start(told, self._kept.remark, "waits for samples")

    def destroy_node(self) -> None:
        """Save what is not saved yet."""
        self._kept.save()
        self._live.save()
        super().destroy_node()

    def health(self) -> Health:
        """Return what is stored, how good the calibration is, and what the last diagnosis found."""
        stored = f"{len(self._store)} samples stored"
        if self._reader.problem:
            level, message = ERROR, self._reader.problem
        elif self._calibration is not None:
            quality = self._calibration.quality
            level, message = OK if quality.grade == "good" else WARN, f"{stored}; {quality}"
        else:
            level, message = (OK, f"{stored}; no calibration yet") if len(self._store) else (STALE, "no samples yet")
        gap = self._gap
        remarks = [(WARN, self._kept.problem), (self._live.level, self._live.sentence())]
        if gap is not None:
            remarks.append((OK if gap.verdict in ("no_gap", "not_identifiable") else WARN, gap.statement))
        for least, told in remarks:
            if told:
                level, message = max(level, least), f"{message}; {told}"
        values = {
            "samples": len(self._store),
            "saved": self._kept.saved,
            "busy_with": self._work.busy_with,
            "partial": self._partial,
            **figures(self._calibration, self.now_s),
            **self._live.figures(),
            **_figures_of(gap),
        }
        return Health(level, message, values)

    def _stored(self) -> Calibration | None:
        """Return the calibration of calibration_file, where there is one."""
        path = Path(self.value("calibration_file"))
        if not path.is_file():
            return None
        calibration = read_calibration(path)
        if not calibration.is_of(self._array):
            raise InputError(f"{path} is the calibration of another array: change calibration_file or array_file")
        return calibration

    def _take(self, messages: list[bytes]) -> None:
        for rows in self._reader.read(messages):
            if not len(rows.values):
                self._store.start_over()
                self._partial = 0
            self._add(rows)

    def _add(self, rows: Rows) -> None:
        """Store the rows that are complete samples: one that is not is counted and costs no other."""
        values = self._store.layout.widened(rows.columns, rows.values)
        are_samples, are_partial = self._store.layout.are_samples(values), self._store.layout.are_partial(values)
        self._live.add(values[are_samples])
        for stamp, row, is_sample, is_partial in zip(rows.stamps, values, are_samples, are_partial, strict=True):
            if is_sample:
                self._store.add(from_stamp(stamp), row)
            elif is_partial:
                self._partial += 1
            else:
                self.refuse("samples", "a value is infinite, a reading is NaN, or an attitude is four zeros")

    def _logged(self, action: Callable[[], str]) -> str:
        self.get_logger().info(told := action())
        return told

    def _calibrate(self) -> str:
        usage = self._usage()
        usage.require_enough()
        array, accept = self._array, names_in(self.value("accept"))
        fit = partial(calibrate, array=array, method=self.value("method"), accept=accept, prior=self._prior())
        recording, left_out = self._live.since_change(self._store.recording())
        samples = usage.with_each_reading_once(recording)
        explain = partial(explained, samples=samples, array=array, progress=self._go_on, accept=accept)
        with adding(left_out):
            calibration = naming_causes(lambda: fit_with_usage(samples, usage, fit), explain)
        if left_out:
            calibration = replace(calibration, notes=(left_out, *calibration.notes))
        self._live.begin(calibration)
        self._publish(calibration)
        update = [] if calibration.update is None else update_sentences(calibration.update)
        further = (*calibration.quality.reasons[1:], *calibration.notes, *update, _in_words(usage), *self._autosave())
        return "; ".join((f"{calibration.quality}; {calibration.method} on {calibration.samples} samples", *further))

    def _prior(self) -> Calibration | None:
        """Return the calibration that was loaded, where it shall be the prior.

        One of the samples that are stored would count them twice: that loaded from the file is older.
        """
        if not self.value("prior"):
            return None
        if self._loaded is None:
            raise Refused("there is no prior: name a calibration_file that exists, or set prior to false")
        return self._loaded

    def _diagnose(self) -> str:
        self._require_separate()
        usage = self._usage()
        remarks = usage.remarks()
        seen = usage.with_each_reading_once(self._store.recording())
        gap = diagnose(seen, self._array, progress=self._go_on, accept=names_in(self.value("accept")))
        self._gap = replace(gap, remarks=(*remarks, *gap.remarks))
        told = " ".join([gap.headline, *(remarks or [f"{_in_words(usage)}."])])
        path: str = self.value("gap_file")
        if not path:
            return told
        write_gap(Path(path), self._gap)
        return f"{told}; written to {path}"

    def _usage(self) -> Usage:
        """Ask the collector how many of sensor 1's samples it used; where none answers, of none.

        Raises
        ------
        Refused
            When a run has just begun: sensors that are interpolated join no sample yet.
        """
        answered = Event()
        if self._collector.service_is_ready():
            future = self._collector.call_async(Trigger.Request())
            future.add_done_callback(lambda _: answered.set())
            if answered.wait(2.0):  # seconds
                usage = Usage.from_json(future.result().message)
                count = max(usage.readings, default=0)
                if 0 < count < FEWEST_SAMPLES and len(self._store) < FEWEST_SAMPLES:
                    raise Refused(f"just started: {count} readings of each sensor have come, keep turning")
                return usage
        return NO_USAGE

    def _go_on(self, stage: str, done: float) -> None:
        """Note how far a diagnosis is, and give it up when the node shall end."""
        self._work.progress(done)
        if not self.context.ok():
            raise Refused(f"the node ended while it was {stage}")

    def _save(self) -> str:
        if self._calibration is None:
            raise Refused("there is no calibration to save: call calibrator/calibrate first")
        path: str = self.value("calibration_file")
        if not path:
            raise Refused(f"no file is named: set the parameter calibration_file of {self.get_name()}")
        self._require_separate()
        write_calibration(Path(path), self._calibration)
        return f"saved to {path}"

    def _require_separate(self) -> None:
        """Check that what the node writes costs neither what it reads, nor a bag, nor one another."""
        written = [Path(path) for name in _WRITTEN if (path := self.value(name))]
        read = [Path(path)] if (path := self.value("array_file")) else []
        require_separate(written, read)

    def _autosave(self) -> list[str]:
        """Save where that is asked for; a file that cannot be written costs no calibration."""
        if not self.value("autosave"):
            return []
        try:
            return [self._save()]
        except (InputError, Refused, OSError) as problem:
            return [f"not saved: {problem}"]

    def _publish(self, calibration: Calibration) -> None:
        self._calibration = calibration
        self._publisher.publish(String(data=calibration_to_yaml(calibration)))


def _check_accept(names: str) -> None:
    """Check the names of what is accepted.

    Raises
    ------
    InputError
        When one is no name of a finding.
    """
    require_names(names_in(names))


def _in_words(usage: Usage) -> str:
    return str(usage) or "no collector says how many samples of sensor 1 were used"


def _figures_of(gap: Gap | None) -> dict[str, object]:
    """Return the figures of a diagnosis for /diagnostics (SI)."""
    if gap is None:
        return {"gap": "not diagnosed"}
    return {
        "gap": gap.verdict,
        "gap_causes": " ".join(gap.named),
        "set_95": " ".join(gap.set_95),
        "gap_samples": len(gap.residue.time_s),
        "gap_before_T": f"{gap.size.before_T:.4g}",
        "gap_after_T": f"{gap.size.after_T:.4g}",
        "gap_floor_T": f"{gap.size.floor_T:.4g}",
    }
