"""Corrected data as the topics of the corrector node, with everything else that was in the bag."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tam_calibration.correction.parts import Corrected
from tam_calibration.messages import point_cloud
from tam_calibration.messages.cdr import NO_TIME, RawMessages, fill, interleave
from tam_calibration.messages.point_cloud import sensor_topic
from tam_calibration.messages.samples import BoolArray, Progress
from tam_calibration.messages.samples import pieces as pieces_of
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray, IntArray
from tam_calibration.recordings.bag_reader import BagReader, open_bag, raw_blocks
from tam_calibration.recordings.bag_source import BagSource
from tam_calibration.recordings.bag_storages import DEFAULT, storage_of
from tam_calibration.recordings.bag_writing import TYPESTORE, BlockWriter, copy_connection, header, write_bag
from tam_calibration.recordings.channel_map import AS_IT_IS, Reading
from tam_calibration.recordings.joining import Streams
from tam_calibration.recordings.recording_file import streams_of

_MAGNETIC_FIELD, _MULTI_ARRAY = "sensor_msgs/msg/MagneticField", "std_msgs/msg/Float64MultiArray"
_POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
_TOPIC_TYPES = {"center": _MAGNETIC_FIELD, "gradient": _MULTI_ARRAY, "field_gradient": _POINT_CLOUD}

_TYPES = TYPESTORE.types


def write_bag_corrected(
    path: Path,
    pieces: Iterable[tuple[Corrected, IntArray]],
    source: Path | None = None,
    progress: Progress = lambda done, total: None,
    how: Reading = AS_IT_IS,
    array: Array | None = None,
) -> None:
    """Write a bag with ``center``, ``gradient`` and ``field_gradient`` as the corrector publishes them.

    Parameters
    ----------
    path : Path
        The bag to write.
    pieces : iterable of Corrected and (N,) array of int
        The results and their stamps, piece by piece; one at least.
    source : Path, optional
        Bag of the raw readings, whose storage is kept and whose other topics are carried over unchanged; each
        result follows the reading of sensor 1 that it came from, or of the sensor that replaced it.
    progress : callable
        Called now and then with the bytes of the source that were carried over, and how many there are.
    how : Reading
        How the source was read.
    array : Array, optional
        Of which array.

    Raises
    ------
    InputError
        When the source cannot be read or the bag cannot be written.
    """
    results = _Results(_rising(pieces))
    with write_bag(path, DEFAULT if source is None else storage_of(source)) as writer:
        if source is None:
            topics = _Topics(writer, "/", results.first)
            for stamps_ns, outputs in results.rest():
                for piece in pieces_of(len(stamps_ns)):
                    rows = topics.messages(stamps_ns[piece], outputs[piece], stamps_ns[piece], results.covariances)
                    writer.write_block(interleave(rows, [np.arange(len(row)) for row in rows]))
        else:
            with open_bag(source) as reader:
                opened = BagSource(reader)
                if opened.is_ros1:
                    raise InputError("the messages of a ROS 1 bag do not go into one of ROS 2: write a .csv instead")
                _merge(opened, streams_of(opened, how, array), reader, writer, results, progress)


def _merge(
    source: BagSource, streams: Streams, reader: BagReader, writer: BlockWriter, results: "_Results", progress: Progress
) -> None:
    """Write the source's messages, and each result behind the reading that set its pace."""
    names = [wanted.table.name for stream, wanted in streams.wanted.items() if not point_cloud.is_channel(stream)]
    own = sensor_topic(1)
    namespace = names[0].removesuffix(own) if f"/{names[0]}".endswith(f"/{own}") else "/"
    replaced = {namespace + topic for topic in _TOPIC_TYPES}
    kept = [connection for connection in reader.connections if connection.topic not in replaced]
    copies = np.array([copy_connection(writer, connection).id for connection in kept])
    topics = _Topics(writer, namespace, results.first)
    places_of = {connection.topic: place for place, connection in enumerate(kept)}
    sensors = [places_of[name] for name in names]
    for block in raw_blocks(reader, kept, progress):
        readings = np.flatnonzero(np.isin(block.connection, sensors))
        stamps_ns = np.zeros(len(readings), dtype=np.int64)
        for name, place in zip(names, sensors, strict=True):
            is_own = block.connection[readings] == place
            stamps_ns[is_own] = source.stamps(name, block.take(readings[is_own]), streams.clock)
        is_pace = results.are_paced(stamps_ns, block.connection[readings] == sensors[0])
        readings, stamps_ns = readings[is_pace], stamps_ns[is_pace]
        chosen, outputs = results.take(stamps_ns)
        places = readings[chosen]
        rows = topics.messages(stamps_ns[chosen], outputs, block.recorded_ns[places], results.covariances)
        copied = replace(block, connection=copies[block.connection])
        writer.write_block(interleave([copied, *rows], [np.arange(len(block)), *[places] * len(rows)]))
    for _ in results.rest():
        pass  # what is wrong with the readings may show at their end


def _rising(pieces: Iterable[tuple[Corrected, IntArray]]) -> Iterator[tuple[Corrected, IntArray]]:
    """Yield results and their stamps, which must rise for each to find its reading."""
    newest_ns = NO_TIME
    for corrected, stamps_ns in pieces:
        if (np.diff(stamps_ns, prepend=newest_ns) <= 0).any():
            raise InputError("the stamps of the samples step back: write a .csv instead, in which time goes on")
        newest_ns = int(stamps_ns[-1])
        yield corrected, stamps_ns


class _Results:
    """Results that come in pieces, taken by their stamps."""

    def __init__(self, pieces: Iterator[tuple[Corrected, IntArray]]) -> None:
        self._pieces = pieces
        self._last_ns = -1
        self.covariances: dict[int, FloatArray] = {}
        self.first, self._stamps_ns = next(pieces)
        self._outputs = self._with_codes(self.first)

    def _with_codes(self, corrected: Corrected) -> FloatArray:
        """Return the outputs (N, 10) with a column of what the samples lack, and keep the covariances of these."""
        self.covariances |= corrected.covariances
        codes = np.zeros(len(corrected.outputs)) if corrected.missing is None else corrected.missing
        return np.column_stack([corrected.outputs, codes])

    def _load(self, latest_ns: int) -> None:
        while (not len(self._stamps_ns) or self._stamps_ns[-1] < latest_ns) and (piece := next(self._pieces, None)):
            self._stamps_ns = np.concatenate([self._stamps_ns, piece[1]])
            self._outputs = np.concatenate([self._outputs, self._with_codes(piece[0])])

    def are_paced(self, stamps_ns: IntArray, is_first: BoolArray) -> BoolArray:
        """Return which readings, those of sensor 1 marked, may have set the pace: others where it was missing."""
        self._load(int(stamps_ns.max(initial=-1)))
        lacks_first = self._outputs[:, 9].astype(int) & 1 == 1
        return np.asarray(is_first | np.isin(stamps_ns, self._stamps_ns[lacks_first]))

    def take(self, stamps_ns: IntArray) -> tuple[IntArray, FloatArray]:
        """Return which of some readings have a result that was not taken yet, and those results (n, 10)."""
        place = np.searchsorted(self._stamps_ns, stamps_ns)
        is_result = np.append(self._stamps_ns, -1)[place] == stamps_ns
        taken = np.maximum.accumulate(np.concatenate([[self._last_ns], np.where(is_result, stamps_ns, -1)]))
        chosen = np.flatnonzero(is_result & (stamps_ns > taken[:-1]))
        outputs = self._outputs[place[chosen]]
        self._last_ns = int(taken[-1])
        left = slice(int(np.searchsorted(self._stamps_ns, self._last_ns, "right")), None)
        self._stamps_ns, self._outputs = self._stamps_ns[left], self._outputs[left]
        return chosen, outputs

    def rest(self) -> Iterator[tuple[IntArray, FloatArray]]:
        """Yield stamps and results (n, 10) of what was not taken."""
        yield self._stamps_ns, self._outputs
        for corrected, stamps_ns in self._pieces:
            yield stamps_ns, self._with_codes(corrected)


class _Topics:
    """The topics of the results in a bag that is written; without ``gradient`` where there is none."""

    def __init__(self, writer: BlockWriter, namespace: str, first: Corrected) -> None:
        self._standard_errors = first.standard_errors
        messages = _messages(first.standard_errors)
        if not np.isfinite(first.outputs[:, 3:]).any():
            del messages["gradient"]
        self._templates = {
            topic: bytes(TYPESTORE.serialize_cdr(message, _TOPIC_TYPES[topic])) for topic, message in messages.items()
        }
        add = writer.add_connection
        self._ids = {topic: add(namespace + topic, _TOPIC_TYPES[topic], typestore=TYPESTORE).id for topic in messages}

    def messages(
        self, stamps_ns: IntArray, results: FloatArray, recorded_ns: IntArray, covariances: Mapping[int, FloatArray]
    ) -> list[RawMessages]:
        """Return for each topic a message for each result, nine outputs and what it lacks."""
        outputs, codes = results[:, :9], results[:, 9]
        errors = np.broadcast_to(self._standard_errors, outputs.shape)
        centers = outputs[:, :3]
        if codes.any():
            errors, centers = errors.copy(), np.hstack([centers, point_cloud.center_covariance(errors)])
            for code in np.unique(codes[codes > 0]):
                own = covariances[int(code)]
                errors[codes == code] = np.sqrt(np.diag(own))
                centers[codes == code, 3:] = own[:3, :3].ravel()
        parts = {
            "center": (12 * point_cloud.FLOAT64_SIZE, centers, stamps_ns),
            "gradient": (9 * point_cloud.FLOAT64_SIZE, outputs[:, point_cloud.GRADIENT_ROW_MAJOR], None),
            "field_gradient": (18 * point_cloud.FLOAT64_SIZE + 1, np.hstack([outputs, errors]), stamps_ns),
        }
        return [
            RawMessages.of_rows(self._ids[topic], recorded_ns, fill(template, *parts[topic]))
            for topic, template in self._templates.items()
        ]


def _messages(standard_errors: FloatArray) -> dict[str, Any]:
    """Return a message of each topic, its numbers and stamp to be filled in."""
    zero = _TYPES["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    dimension, layout = _TYPES["std_msgs/msg/MultiArrayDimension"], _TYPES["std_msgs/msg/MultiArrayLayout"]
    dimensions = [dimension(*each) for each in point_cloud.GRADIENT_DIMENSIONS]
    field: Any = _TYPES["sensor_msgs/msg/PointField"]
    fields = [
        field(name, offset, field.FLOAT64, 1)
        for name, offset in point_cloud.field_offsets(point_cloud.FIELD_GRADIENT_COLUMNS)
    ]
    size = point_cloud.FLOAT64_SIZE * len(fields)
    return {
        "center": _TYPES[_MAGNETIC_FIELD](header(), zero, point_cloud.center_covariance(standard_errors)),
        "gradient": _TYPES[_MULTI_ARRAY](layout(dimensions, 0), np.zeros(9)),
        "field_gradient": _TYPES[_POINT_CLOUD](
            header(), 1, 1, fields, False, size, size, np.zeros(size, np.uint8), True
        ),
    }
