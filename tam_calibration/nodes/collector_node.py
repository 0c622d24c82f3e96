"""The collector node: joins the topics of the sensors into samples, and watches coverage and losses."""

import math
import struct
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from tam_calibration.core.interpolation import AveragedRates
from tam_calibration.fit.coverage import Coverage
from tam_calibration.fit.turns import LiveCoverage
from tam_calibration.messages.missing import LiveMissing, are
from tam_calibration.messages.point_cloud import CHANNEL_TOPICS, SampleLayout
from tam_calibration.messages.samples import NO_USAGE, turns_of, why_doubled
from tam_calibration.messages.stream import SILENCE_NS, sensor_stream
from tam_calibration.messages.synchroniser import Sample, Synchroniser
from tam_calibration.messages.timeline import Run, StampFigures
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import STRONGEST_FIELD_T
from tam_calibration.model.limits import SHORTEST_ATTITUDE, largest_of
from tam_calibration.model.recording import RATE_COLUMNS
from tam_calibration.model.units import to_nanotesla
from tam_calibration.nodes.base import ERROR, OK, STALE, WARN, Health, TamNode
from tam_calibration.nodes.inputs import FrameCheck, Input, map_of_topics, own_map
from tam_calibration.nodes.markers import Shown, coverage_markers
from tam_calibration.nodes.node_parameters import REAL_TIME, SHARED, Rule
from tam_calibration.nodes.session import precede
from tam_calibration.nodes.topics import RELIABLE_STREAM, STREAM, cloud_writer, make_cloud, message_class, to_stamp
from tam_calibration.recordings.channel_map import AS_IT_IS, Pick
from tam_calibration.recordings.intake import is_of_field

_SCALAR_TOPIC = CHANNEL_TOPICS["scalar"]
_SCALAR_TYPES = ("sensor_msgs/MagneticField", "std_msgs/Float64")

RULES = (
    *SHARED,
    Rule("scalar_type", "sensor_msgs/MagneticField", f"Message type of {_SCALAR_TOPIC}.", choices=_SCALAR_TYPES),
    Rule("map_file", "", "Map YAML: topics of sensors and channels; empty for tam_1/magnetic_field and so on."),
    Rule(
        "tolerance_s",
        AS_IT_IS.tolerance_s,
        "Difference of stamps up to which readings count as of one moment; beyond, they are interpolated [s].",
        bounds=(0.0, 10.0),
    ),
    REAL_TIME,
    Rule(
        "silence_s",
        SILENCE_NS / 1e9,
        "Time without a message after which a sensor is reported, and samples go on without it [s].",
        bounds=(0.1, 3600.0),
    ),
)


class Collector(TamNode):
    """Publishes `samples` of the sensors' topics; /diagnostics tells what is missing, lost or silent."""

    _synchroniser: Synchroniser | None

    def __init__(self) -> None:
        super().__init__("collector", RULES)
        sensor_count = self._array.sensor_count
        self._turns = turns_of(self._array.mounting)
        self._frames = FrameCheck(self._array.mounting, self.get_logger().warning)
        self._layout = SampleLayout.whole(sensor_count, self._array.further_channels)
        first = self._layout.columns.index(RATE_COLUMNS[0]) - 1
        self._at_rates = slice(first, first + len(RATE_COLUMNS))
        self._sensors = [sensor_stream(sensor + 1) for sensor in range(sensor_count)]
        scalar_type, map_file = self.value("scalar_type"), self.value("map_file")
        self._map = map_of_topics(map_file, self._array) if map_file else own_map(self._array, scalar_type)
        self._topics_of_sensors = list(dict.fromkeys(pick.topic for pick in self._map.sensors))
        self._is_received, self._scalar_is_held = self._map.time == "received", False
        self._frame_id: str = self.value("frame_id")
        self._heard_s: dict[str, float] = {}
        self._losses: list[tuple[Input, Callable[[], int]]] = []
        self._looked_s = -math.inf
        self._start_over()
        self._samples = self.offer(PointCloud2, "samples", RELIABLE_STREAM)
        self._writer = cloud_writer(self._layout.columns, self._frame_id)
        self._row = struct.Struct(f"<{len(self._layout.columns)}d")
        self._markers = Shown(self, MarkerArray, "coverage_markers", self._frame_id)
        self._waiting = defaultdict[str, dict[str, Pick]](dict)
        for stream, pick in self._map.streams.items():
            self._waiting[pick.topic][stream] = pick
        self.create_steady_timer(1.0, self._show_coverage)  # as often as /diagnostics has its sentence
        self._subscribe()
        self._scheduling = precede() if self.value("real_time") else "normal"
        self.serve("reset", self._reset)
        self.serve("usage", self._tell_usage)
        self.say_start(f"waits for {', '.join(self._topics_of_sensors)}")

    def _start_over(self) -> None:
        self._synchroniser = None
        self._coverage, self._run, self._missing, self._rates = LiveCoverage(), Run(), LiveMissing(), AveragedRates()
        self._bought_s, self._bought = -math.inf, dict[str, float | None]()
        self._stamps = defaultdict[str, StampFigures](StampFigures)
        self._lost, self._lost_before = 0, Counter[str]()
        self._steps, self._step, self._stepped_s = 0, "none", -math.inf
        for _, lost in self._losses:
            lost()  # before the new run

    def health(self) -> Health:
        """Return what hinders, or what to do next for the coverage; after a stall no sensor counts as silent."""
        process = {"listeners": self._samples.get_subscription_count(), "scheduling": self._scheduling}
        if self._synchroniser is None:
            topics = ", ".join(self._topics_of_sensors)
            return Health(STALE, f"no message yet on {topics}: start the sensors' drivers or play a bag", process)
        self._count_lost(self._synchroniser)
        now_s = time.monotonic()
        # There is one look a second: after a longer time this process stood still, not the sensors.
        is_awake, self._looked_s = now_s < self._looked_s + 2.0, now_s
        limit_s = now_s - self.value("silence_s")
        silent = [name for name in self._sensors if is_awake and self._heard_s[name] < limit_s]
        if len(silent) == len(self._sensors):
            self._deliver(self._synchroniser.flush())
        coverage = self._coverage.summary()
        level, message = self._judge(self._synchroniser, silent) or (OK, f"{coverage.advice}{self._look_at_bought()}")
        if now_s < self._stepped_s + 30.0:  # so long a step of the stamps is a warning
            level, message = max(level, WARN), f"{message}; {self._step}"
        missing = {"missing_readings": "; ".join(self._missing.sentences())}
        lost = {"lost": self._lost, "steps": self._steps, "last_step": self._step}
        pace = self._stamps[self._sensors[0]]
        stamps = {
            f"{name}.{figure}": value
            for name, figures in self._stamps.items()
            for figure, value in figures.summary(pace).items()
        }
        counted = _describe(coverage) | self._bought | _count(self._synchroniser) | lost
        return Health(level, message, counted | missing | process | stamps)

    def _look_at_bought(self) -> str:
        """Return how well the turn tells the biases so far, for people, and keep the figures."""
        if time.monotonic() > self._bought_s + 10.0:  # each look takes a tenth of a second
            self._bought_s = time.monotonic()
            names = ("bias_error_T", "bias_error_with_gyroscope_T")
            self._bought = dict(zip(names, self._coverage.bought(self._array), strict=False))
        alone_T, beside_T = self._bought.values()
        if beside_T is None:
            return ""
        told = f"biases are known to {to_nanotesla(beside_T):.2g} nT so far"
        return f"; {told}, without the gyroscope to {to_nanotesla(alone_T or np.inf):.2g} nT"

    def _judge(self, synchroniser: Synchroniser, silent: Sequence[str]) -> tuple[bytes, str] | None:
        """Return level and sentence of what hinders most, or None."""
        lost = sum(losses.dropped for losses in synchroniser.losses.values())
        new_losses, self._lost = lost - self._lost, lost
        problems = self._problems(synchroniser, silent)
        if problems:
            without = synchroniser.silent
            if without and len(self._sensors) - len({*without, *silent}) > 1:
                problems.append(f"samples go on without {' and '.join(without)}")
            return ERROR, "; ".join(problems)
        if self._frames.problems:
            return WARN, "; ".join(self._frames.problems.values())
        unstamped = [name for name, stamps in self._stamps.items() if stamps.are_zero]
        if unstamped:
            return WARN, _tell_unstamped(unstamped)
        if doubled := [topic for topic in self._topics_of_sensors if self.count_publishers(topic) > 1]:
            return WARN, f"{' and '.join(doubled)} has more than one publisher: stop all but one, or the fit mixes them"
        if new_losses:
            return WARN, f"{new_losses} messages lost in the last second: {synchroniser.explain_losses()}"
        return None

    def _problems(self, synchroniser: Synchroniser, silent: Sequence[str]) -> list[str]:
        """Return why sensors cannot join the samples: they are silent, without stamps, or of another time."""
        problems = []
        if silent:
            since = ", ".join(f"{name} since {self._time_of_day(self._heard_s[name])}" for name in silent)
            problems.append(f"nothing from {since}: check sensor, cable and driver")
        missing = self._missing.mostly()
        problems += missing.values()
        problems += filter(None, (why_doubled(name, synchroniser.losses[name]) for name in self._sensors))
        unstamped = [name for name in self._sensors if name not in silent and self._stamps[name].are_zero]
        if unstamped:
            problems.append(_tell_unstamped(unstamped))
        apart = set(synchroniser.silent) - {*silent, *unstamped, *missing}
        drops_all = synchroniser.drops_everything and len(silent) < len(self._sensors)
        if drops_all or apart:
            which = "no samples can" if drops_all else f"{' and '.join(sorted(apart))} cannot"
            problems.append(f"{which} be joined: {synchroniser.explain_losses()}; compare stamps and tolerance_s")
        return problems

    @staticmethod
    def _time_of_day(monotonic_s: float) -> str:
        return time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(time.time() - time.monotonic() + monotonic_s))

    def mend_of_type(self, topic: str, published: str) -> str:
        """Return what mends an input that is published as another type: of the scalar, a parameter.

        Parameters
        ----------
        topic : str
            Its complete name.
        published : str
            The type, such as ``sensor_msgs/msg/Imu``.
        """
        scalar_type = published.replace("/msg/", "/")
        if topic == self.resolve_topic_name(_SCALAR_TOPIC) and scalar_type in _SCALAR_TYPES:
            return f"start the collector with scalar_type:={scalar_type}"
        return super().mend_of_type(topic, published)

    def _subscribe(self) -> None:
        """Subscribe to the topics whose type is known by now: as the map states it, or as they are published."""
        for topic, picks in list(self._waiting.items()):
            stated = {pick.type for pick in picks.values()} - {""}
            types = stated or {each.topic_type for each in self.get_publishers_info_by_topic(topic)}
            if not types:
                continue
            try:
                self._listen_to(topic, min(types), picks)
                del self._waiting[topic]
            except InputError as problem:
                if stated:
                    raise
                self.refuse(topic, str(problem))  # somebody else's mistake ends no node

    def _listen_to(self, topic: str, msgtype: str, picks: Mapping[str, Pick]) -> None:
        kind = message_class(msgtype)
        if kind is None:
            raise InputError(f"{topic} has messages of type {msgtype}, which is not installed here")
        read = Input(topic, picks, kind)
        if not read.is_stamped and not self._is_received and not picks.keys().isdisjoint(self._sensors):
            self._is_received = True
            self.get_logger().info(f"the messages of {topic} have no stamps: times are those of their arrival")
        if "scalar" in picks:
            self._scalar_is_held, self._synchroniser = not read.is_stamped, None
        self._losses.append((read, self.listen_in_order(kind, topic, partial(self._take, read), STREAM)))

    def _count_lost(self, synchroniser: Synchroniser) -> None:
        """Count the messages that were lost on the way."""
        for read, lost in self._losses:
            count = lost()
            for stream in read.picks:
                synchroniser.losses[stream].lost += count

    def _take(self, read: Input, message: bytes, arrived_ns: int) -> None:
        for stream in read.picks:
            try:
                self._take_stream(read, stream, message, arrived_ns)
            except InputError as problem:
                self.refuse(read.topic, str(problem))
                if self._synchroniser is not None:
                    self._synchroniser.refuse(stream)

    def _take_stream(self, read: Input, stream: str, message: bytes, arrived_ns: int) -> None:
        decode, to_si = read.decoder(stream, message)
        stamp_ns, values = decode(message)
        if self._synchroniser is None:
            self._synchroniser = self._make_synchroniser()
        if stream in self._heard_s:
            self._heard_s[stream] = time.monotonic()
        if self._is_received:
            stamp_ns = arrived_ns
        if stamp_ns is not None:
            self._stamps[stream].add(stamp_ns, arrived_ns)
        raw, values = values, values if to_si is None else to_si(values)
        largest = STRONGEST_FIELD_T if is_of_field(stream) else largest_of(stream)
        if code := self._missing.take(stream, raw, any(abs(value) > largest for value in values)):
            self.refuse(read.topic, f"a reading {are(code, 1, stream)}")
            self._synchroniser.refuse(stream, code=code)
            return
        if read.has_header:
            self._frames.check(stream, message)
        if stream == "attitude" and not any(abs(component) >= SHORTEST_ATTITUDE for component in values):
            return  # the driver says that it has none
        if stream in self._turns:
            values = self._turns[stream](*values)
        if stream == "gyroscope":
            self._rates.add(None if stamp_ns is None else np.array([stamp_ns]), np.array([values]))
        if samples := self._synchroniser.push(stream, stamp_ns, values, arrived_ns):
            self._deliver(samples)
        if self._synchroniser.steps:
            self._tell_steps(self._synchroniser)

    def _tell_steps(self, synchroniser: Synchroniser) -> None:
        """Log the steps of the stamps, and keep them for /diagnostics; one ahead after losses is a gap."""
        self._count_lost(synchroniser)
        for step in synchroniser.steps:
            lost = synchroniser.losses[step.stream].lost - self._lost_before[step.stream]
            self._lost_before[step.stream] += lost
            if 0 < step.size_ns <= 2 * lost * self._stamps[step.stream].interval_ns:
                gap_s = step.size_ns / 1e9
                self._step = f"{lost} messages of {step.stream} were lost on the way, {gap_s:.3g} s: look at the load"
            else:
                self._step = step.sentence
                self._steps += not step.is_pause
            self.get_logger().warning(self._step)
        self._stepped_s = time.monotonic()
        synchroniser.steps.clear()

    def _make_synchroniser(self) -> Synchroniser:
        """Return a synchroniser that waits for the scalar from the first sample on where somebody publishes one."""
        self._heard_s = dict.fromkeys(self._sensors, time.monotonic())
        return Synchroniser(
            self._layout,
            tolerance_ns=round(self.value("tolerance_s") * 1e9),
            scalar_is_held=self._scalar_is_held and not self._is_received,
            expected=("scalar",) if self._map.scalar and self.count_publishers(self._map.scalar.topic) else (),
            delay_s=self._array.stamp_delay_s,
            silence_ns=round(self.value("silence_s") * 1e9),
        )

    def _deliver(self, samples: Sequence[Sample]) -> None:
        for sample in map(self._averaged, samples):
            if self._run.begins_again(sample.stamp_ns, sample.values[: 3 * len(self._sensors)]):
                self._coverage.reset()
                self.get_logger().warning("a recording is played once more: its first sample begins the run anew")
            if not math.isnan(sum(sample.values[: 3 * len(self._sensors)])):
                has_rates = not math.isnan(sample.values[self._at_rates.start])
                self._coverage.add(sample.values[:3], sample.stamp_ns / 1e9, has_rates)
            if self._samples.get_subscription_count():
                row = self._row.pack(sample.stamp_ns / 1_000_000_000, *sample.values)
                self._samples.publish(self._writer.message(to_stamp(sample.stamp_ns), row))

    def _averaged(self, sample: Sample) -> Sample:
        """Return a sample with the mean angular velocity since the one before; else the newest."""
        stamp_ns, values = sample.stamp_ns, sample.values
        newest = values[self._at_rates]
        if self._rates.skips(stamp_ns, newest):
            return sample
        [mean] = self._rates.means(np.array([stamp_ns]), np.array([newest])).tolist()
        return sample._replace(values=(*values[: self._at_rates.start], *mean, *values[self._at_rates.stop :]))

    def _show_coverage(self) -> None:
        self._subscribe()
        if self._markers.is_wanted():
            header = self._markers.header(self.get_clock().now().nanoseconds)
            self._markers.publisher.publish(coverage_markers(header, self._coverage.summary()))

    def _tell_usage(self) -> str:
        """Return how many of sensor 1's samples were used, and why not the others, as JSON."""
        usage = NO_USAGE
        if self._synchroniser:
            self._count_lost(self._synchroniser)
            usage = self._synchroniser.usage
        others = tuple(self._frames.problems.values())
        return replace(usage, missing=self._missing.sentences(), other_frames=others).to_json()

    def _reset(self) -> str:
        """Forget coverage and losses; an empty cloud tells the calibrator to start over as well."""
        self._start_over()
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id=self._frame_id)
        self._samples.publish(make_cloud(header, self._layout.columns))
        return "coverage, losses and stored samples are forgotten: start turning the array"


def _tell_unstamped(streams: Sequence[str]) -> str:
    drivers = " and ".join(streams)
    return f"the driver of {drivers} does not stamp its messages: all stamps are 0"


def _describe(coverage: Coverage) -> dict[str, object]:
    return {
        "fraction": f"{coverage.fraction:.3f}",
        "missing": coverage.missing,
        "enough": coverage.enough,
        "relative_error": f"{coverage.relative_error:.3g}",
        "advice": coverage.advice,
    }


def _count(synchroniser: Synchroniser) -> dict[str, object]:
    by_stream = {
        f"{name}.{what}": getattr(losses, what)
        for name, losses in synchroniser.losses.items()
        for what in ("received", "lost", "unmatched", "duplicate", "late", "implausible", "unusable", "missing")
    }
    overall = {
        "samples": synchroniser.delivered,
        "partial": synchroniser.partial,
        "silent": " ".join(synchroniser.silent),
        "restarts": synchroniser.restarts,
    }
    return overall | {"losses": synchroniser.explain_losses()} | by_stream
