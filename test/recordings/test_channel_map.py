"""The map of a recording: what its file may hold, and that it reads back."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tam_calibration.files.yaml_document import dump_mapping
from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings.channel_map import (
    ChannelMap,
    Pick,
    TextFormat,
    TimeColumn,
    map_of,
    map_to_mapping,
    read_map,
)

OF_A_BAG = """
sensors:
  - {topic: /mag0}
  - {topic: /imu_raw, field: mag}
  - {topic: /adc, fields: ["data[3]", "data[4]", "data[5]"], unit: nT}
  - {topic: sensor_mag, instance: 1}
scalar: {topic: /overhauser, field: data, unit: nT}
attitude: {topic: /imu/data, field: orientation, world: ned}
gyroscope: {topic: /imu/data, field: angular_velocity}
temperature: {topic: /mag0/temperature, field: temperature}
current: {topic: /battery, field: current}
further: {current_2_A: {topic: /motor, field: current}}
time: received
"""
"""Every key of a map of messages."""

OF_A_TEXT = """
text: {delimiter: ";", decimal: ",", header_line: 3, comment: "#"}
time: {column: Timestamp, format: iso8601}
sensors:
  - {columns: [Bx1, By1, Bz1], unit: uT}
  - {columns: [5, 6, 7], scale_nT: 0.15}
  - {file: CH0.csv, columns: [2, 3, 4]}
scalar: {column: F, unit: nT}
"""
"""The same of a map of rows."""

_WORDS = st.text(st.characters(codec="utf-8", exclude_categories=["C", "Z"]), min_size=1, max_size=8)
_PLACES = st.one_of(
    st.builds(dict, topic=_WORDS, field=_WORDS),
    st.builds(dict, topic=_WORDS, fields=st.lists(_WORDS, min_size=3, max_size=3)),
    st.builds(dict, topic=_WORDS, instance=st.integers(0, 9), world=st.sampled_from(["enu", "ned"])),
    st.builds(dict, file=_WORDS, columns=st.lists(st.one_of(_WORDS, st.integers(1, 99)), min_size=1, max_size=3)),
    st.builds(dict, column=st.one_of(_WORDS, st.integers(1, 99))),
)
_UNITS = st.one_of(
    st.just({}),
    st.builds(dict, unit=st.sampled_from(["T", "mT", "uT", "nT", "G", "mG"])),
    st.builds(dict, scale_nT=st.floats(1e-9, 1e9)),
)
_PICKS = st.builds(lambda place, unit: Pick(**place, **unit), _PLACES, _UNITS)
_TIMES = st.one_of(
    st.sampled_from(["stamp", "received"]),
    st.builds(TimeColumn, column=st.one_of(_WORDS, st.integers(1, 99)), format=st.one_of(st.just(""), _WORDS)),
    st.builds(TimeColumn, rate_hz=st.floats(1e-3, 1e6)),
)
_TEXTS = st.builds(
    TextFormat,
    delimiter=st.sampled_from([None, ",", ";", "\t", " "]),
    decimal=st.sampled_from([None, ".", ","]),
    header_line=st.one_of(st.none(), st.integers(0, 99)),
    comment=st.sampled_from([None, "#", "//"]),
)
MAPS = st.builds(
    ChannelMap,
    sensors=st.lists(_PICKS, min_size=1, max_size=4),
    scalar=st.one_of(st.none(), _PICKS),
    attitude=st.one_of(st.none(), _PICKS),
    further=st.one_of(st.just({}), st.builds(lambda pick: {"current_2_A": pick}, _PICKS)),
    time=_TIMES,
    text=_TEXTS,
)


@settings(deadline=None, max_examples=60)
@given(MAPS)
def test_any_map_reads_back(tmp_path_factory, channel_map):
    """From its keys and values, and from its file, which states no more than differs from the defaults."""
    assert map_of(map_to_mapping(channel_map)) == channel_map
    path = tmp_path_factory.getbasetemp() / "map.yaml"
    path.write_text(dump_mapping(map_to_mapping(channel_map)), encoding="utf-8")
    assert read_map(path) == channel_map


@pytest.mark.parametrize("text", [OF_A_BAG, OF_A_TEXT])
def test_every_key_is_kept(tmp_path, text):
    """The examples of the documentation read, and are written with the same keys."""
    (tmp_path / "map.yaml").write_text(text)
    channel_map = read_map(tmp_path / "map.yaml")
    assert set(map_to_mapping(channel_map)) == {line.partition(":")[0] for line in text.splitlines() if line[:1] > " "}
    (tmp_path / "again.yaml").write_text(dump_mapping(map_to_mapping(channel_map)))
    assert read_map(tmp_path / "again.yaml") == channel_map


def test_what_a_map_means(tmp_path):
    """Streams in their order, files, clock, and the tesla of a unit or a count."""
    (tmp_path / "map.yaml").write_text(OF_A_BAG)
    channel_map = read_map(tmp_path / "map.yaml")
    assert list(channel_map.streams) == [
        *(f"tam_{number}" for number in range(1, 5)),
        *("scalar", "attitude", "gyroscope", "temperature", "current", "current_2_A"),
    ]
    assert channel_map.clock == "received" and channel_map.time_column == TimeColumn()
    assert [pick.factor for pick in channel_map.sensors] == [None, None, 1e-9, None]
    assert channel_map.sensors[3].table == ("sensor_mag", 1)
    (tmp_path / "map.yaml").write_text(OF_A_TEXT)
    channel_map = read_map(tmp_path / "map.yaml")
    assert channel_map.files == ["CH0.csv"] and channel_map.clock == "stamp"
    assert channel_map.sensors[1].factor == pytest.approx(0.15e-9)
    assert channel_map.time_column == TimeColumn(column="Timestamp", format="iso8601")


def test_a_map_is_told_in_one_line(tmp_path):
    """What is taken for what, with instance, columns and units, and whose time it is."""
    (tmp_path / "map.yaml").write_text(OF_A_BAG)
    told = str(read_map(tmp_path / "map.yaml"))
    assert told.startswith("sensor 1: /mag0; sensor 2: /imu_raw mag; sensor 3: /adc data[3], data[4], data[5] [nT]; ")
    assert "sensor 4: sensor_mag [1]; scalar: /overhauser data [nT]" in told and told.endswith(", the recorder's times")
    told = str(map_of({"sensors": [{"columns": [2, 3, 4], "scale_nT": 0.15}], "time": {"rate_hz": 25}}))
    assert told == "sensor 1: columns 2, 3, 4 [0.15 nT a count], 25 samples a second"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("sensors: [{topic: /a, unit: nT, scale_nT: 2}]", "give either unit or scale_nT"),
        ("sensors: [{topic: /a, units: nT}]", "units"),
        (
            "sensors: [{topic: /a, unit: nanotesla}]",
            "sensors.1.unit: input should be 'T' or 'mT' or 'uT' or 'nT' or 'G' or 'mG'",
        ),
        ("sensors: [{topic: /a, scale_nT: 0}]", "scale_nT"),
        ("sensors: [{topic: /a}]\nsclar: {topic: /b}", "sclar"),
        ("sensors: [{topic: /a}]\nfurther: {speed: {topic: /b}}", "speed"),
        ("sensors: [{topic: /a}]\ntime: header", "time"),
        ("sensors: [{topic: /a}]\ntime: {column: t, rate_hz: 5}", "give either column or rate_hz"),
        ("sensors: [{topic: /a}]\ntime: {rate_hz: .nan}", "time.rate_hz: input should be"),
        ("sensors: [{topic: /a}]\ntext: {header_line: -1}", "header_line"),
        ("sensors: [{topic: [1]}]", "topic"),
        ("sensors: []", "name at least one"),
        ("scalar: {topic: /a}", "sensors"),
        ("- 1", "map.yaml"),
        ("{", "map.yaml"),
    ],
)
def test_what_is_no_map_is_one_sentence(tmp_path, content, words):
    """A key that is not known, a value that is none, two answers to one question: named, with the file."""
    (tmp_path / "map.yaml").write_text(content)
    with pytest.raises(InputError) as told:
        read_map(tmp_path / "map.yaml")
    assert words in str(told.value) and "map.yaml" in str(told.value)
    assert "\n" not in str(told.value) and len(str(told.value)) < 400


def test_a_map_that_is_not_there_is_named():
    """As any file."""
    with pytest.raises(InputError, match=r"none\.yaml"):
        read_map(Path("none.yaml"))


def test_too_many_sensors_are_refused():
    """As in any recording."""
    with pytest.raises(InputError, match="sensors"):
        map_of({"sensors": [{"topic": f"/mag{number}"} for number in range(65)]})
