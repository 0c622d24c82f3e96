"""The foreign recordings hold the truth, as libraries read it that have no part in this package."""

import numpy as np
import pandas as pd
import pytest
from foreign.bags import BAGS, OWN
from foreign.logs import LOGS
from foreign.texts import TEXTS
from numpy.testing import assert_allclose
from rosbags.highlevel import AnyReader

READINGS = ("magnetic_field", "vector", "mag")


def vectors_of(message):
    """Return the readings of a sensor, or of all, that a message holds; none for other messages."""
    if len(data := np.atleast_1d(getattr(message, "data", []))) == 13:
        return data[:12]
    vector = next((getattr(message, name) for name in READINGS if hasattr(message, name)), None)
    return None if vector is None else [vector.x, vector.y, vector.z]


@pytest.mark.parametrize("foreign", BAGS[:7], ids=lambda foreign: foreign.file)
def test_bags(foreign, tmp_path):
    """The library rosbags finds every sensor's readings, in the order of the recorder's times, up to the unit.

    Not in the last bag: it reads no MCAP that has a topic in JSON.
    """
    found = {}
    with AnyReader([foreign.write(tmp_path)], default_typestore=OWN) as reader:
        for connection, _, raw in reader.messages():
            if (values := vectors_of(reader.deserialize(raw, connection.msgtype))) is not None:
                found.setdefault(connection.topic, []).append(values)
    expected = foreign.truth.readings_T.reshape(len(foreign.truth.time_s), 12)
    order = (
        [f"/array/{place}" for place in ("front", "left", "back", "right")] if "own" in foreign.file else sorted(found)
    )
    readings = np.column_stack([found[topic] for topic in order])
    unit = 10.0 ** np.round(np.log10(np.abs(readings).max() / np.abs(expected).max()))
    assert_allclose(readings, unit * expected, rtol=1e-12)


def test_px4(tmp_path):
    """The library pyulog finds four instances of ``sensor_mag`` in gauss, and no fault."""
    pyulog = pytest.importorskip("pyulog")
    log = pyulog.ULog(str(LOGS[0].write(tmp_path)))
    assert not log.file_corruption
    for sensor in range(4):
        data = log.get_dataset("sensor_mag", sensor).data
        readings = np.column_stack([data[axis] for axis in "xyz"])
        assert_allclose(readings, 1e4 * LOGS[0].truth.readings_T[:, sensor], atol=1e-7)
        assert_allclose(data["timestamp_sample"] / 1e6 - 5, LOGS[0].truth.sensor_time_s[:, sensor], atol=1e-6)
    assert log.get_dataset("vehicle_magnetometer").data["magnetometer_ga[2]"].size == len(data["x"])


def test_ardupilot(tmp_path):
    """The library pymavlink finds MAG of three instances in milligauss, and the attitude in degrees."""
    reader = pytest.importorskip("pymavlink.DFReader")
    log = reader.DFReader_binary(str(LOGS[1].write(tmp_path)))
    found = {0: [], 1: [], 2: []}
    while (message := log.recv_match(type=["MAG", "ATT"])) is not None:
        if message.get_type() == "MAG":
            found[message.I].append([message.MagX, message.MagY, message.MagZ])
        else:
            assert abs(message.Roll) <= 180 and 0 <= message.Yaw <= 360
    log.close()
    for sensor, readings in found.items():
        assert_allclose(readings, 1e7 * LOGS[1].truth.readings_T[:, sensor], atol=0.501)


HOW = {
    "european.csv": {"sep": ";", "decimal": ",", "encoding": "cp1252"},
    "tabs.txt": {"sep": "\t", "comment": "#"},
    "r.csv": {"index_col": 0},
    "logger.csv": {"skiprows": 4, "skipinitialspace": True, "skip_blank_lines": False},
    "numbers.dat": {"sep": r"\s+", "header": None},
    "counter.csv": {},
}
"""How pandas reads the texts of one table with a time."""


@pytest.mark.parametrize("foreign", [each for each in TEXTS if each.file in HOW], ids=lambda foreign: foreign.file)
def test_texts(foreign, tmp_path):
    """The library pandas finds a time, twelve axes and the scalar."""
    table = pd.read_csv(foreign.write(tmp_path), **HOW[foreign.file])
    factor = 1e3 if foreign.file == "european.csv" else 1
    assert_allclose(factor * table.iloc[:, 1:].to_numpy(), foreign.truth.table_nT, atol=0.051)


def test_parquet(tmp_path):
    """The library pandas finds the table with its times."""
    table = pd.read_parquet(LOGS[2].write(tmp_path))
    assert_allclose(1e3 * table.iloc[:, 1:14].to_numpy(), LOGS[2].truth.table_nT, rtol=1e-12)
    assert_allclose((table["acquired"] - table["acquired"][0]).dt.total_seconds(), LOGS[2].truth.time_s, atol=1e-9)
