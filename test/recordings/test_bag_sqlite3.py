"""Databases that somebody made to cost time or memory end in one sentence, by the guards of SQLite."""

import os
import signal
import sqlite3
import time
import tracemalloc
from contextlib import closing
from threading import Timer

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings import bag_reader, bag_sqlite3, read_recording
from tam_calibration.recordings.bag_writing import recover
from tam_calibration.results import write_recording

MOST_S, MOST_BYTES = 10.0, 64 << 20
"""Most time and memory that a hostile bag of some kilobytes may take."""

ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT"

HOSTILE = {
    "a recursive view of messages": (
        "is no plain table",
        [
            "DROP TABLE messages",
            f"CREATE VIEW messages AS {ENDLESS} i AS id, 1 AS topic_id, i AS timestamp, x'' AS data FROM n",
        ],
    ),
    "a recursive view of topics": (
        "is no plain table",
        ["DROP TABLE topics", f"CREATE VIEW topics AS {ENDLESS} i AS id, '/' || i AS name, 'a' AS type FROM n"],
    ),
    "300 000 topics": (
        "has 300005 topics: more than 4096 are not read",
        [
            "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 300000) "
            "INSERT INTO topics SELECT i + 10, '/topic_' || i, 'std_msgs/msg/String', 'cdr', '', '' FROM n"
        ],
    ),
    "a generated blob": (
        "is no plain table",
        ["ALTER TABLE messages ADD COLUMN more BLOB GENERATED ALWAYS AS (zeroblob(524288)) VIRTUAL"],
    ),
    "blobs that are generated in place of the messages": (
        "is no plain table",
        [
            "ALTER TABLE messages RENAME TO old",
            "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
            "data BLOB GENERATED ALWAYS AS (zeroblob(524288)) VIRTUAL)",
            "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 20000) "
            "INSERT INTO messages (id, topic_id, timestamp) SELECT i, 1, i FROM n",
        ],
    ),
    "an index that computes": (
        "is no plain table",
        ["CREATE INDEX slow ON messages (hex(zeroblob(100000000 + id % 2))) WHERE id < 0"],
    ),
    "a virtual table": (
        "is no plain table|no such module",
        ["DROP TABLE messages", "CREATE VIRTUAL TABLE messages USING fts5(topic_id, timestamp, data)"],
    ),
}


def spoiled(path, recording, statements):
    """Write a bag, and change its database by statements of SQL."""
    write_recording(path, recording, "sqlite3")
    with closing(sqlite3.connect(path / f"{path.name}.db3")) as database, database:
        for statement in statements:
            database.execute(statement)
    return path


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("function", [read_recording, lambda path: recover(path, path.with_name("new"))])
def test_a_hostile_database_ends_in_one_sentence(tmp_path, recording, name, function):
    """Within seconds, and without the memory that it asks for."""
    sentence, statements = HOSTILE[name]
    path = spoiled(tmp_path / "bag", recording.take(slice(4)), statements)
    tracemalloc.start()
    began = time.process_time()
    with pytest.raises(InputError, match=sentence) as problem:
        function(path)
    assert time.process_time() - began < MOST_S and tracemalloc.get_traced_memory()[1] < MOST_BYTES
    tracemalloc.stop()
    assert "\n" not in str(problem.value) and "damaged" not in str(problem.value)


@pytest.fixture(scope="module")
def long_bag(recording, tmp_path_factory):
    """Return the path of a bag whose reading takes some tenths of a second."""
    rows = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 2000000)"
    more = f"{rows} INSERT INTO messages (topic_id, timestamp, data) SELECT 1, i, x'00' FROM n"
    return spoiled(tmp_path_factory.mktemp("long") / "bag", recording.take(slice(4)), [more])


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_interrupts_sqlite(long_bag, number):
    """Within some milliseconds of this process' time, in whatever query."""
    before = signal.signal(number, lambda *told: (_ for _ in ()).throw(KeyboardInterrupt))
    came = []
    timer = Timer(0.1, lambda: (came.append(time.process_time()), os.kill(os.getpid(), number)))
    timer.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            read_recording(long_bag)
        assert time.process_time() - came[0] < 0.5
    finally:
        timer.join()
        signal.signal(number, before)


def test_a_query_that_takes_more_steps_than_a_recording_ends(tmp_path, recording, monkeypatch):
    """In one sentence; the bound is ten times what reading takes."""
    write_recording(tmp_path / "bag", recording, "sqlite3")
    monkeypatch.setattr(bag_sqlite3, "_STEPS", 100)
    monkeypatch.setattr(bag_sqlite3, "_FREE_STEPS", 0)
    monkeypatch.setattr(bag_sqlite3, "_STEPS_A_BYTE", bag_sqlite3._STEPS_A_BYTE / 10)
    assert_array_equal(read_recording(tmp_path / "bag").readings_T, recording.readings_T)
    bag_reader._opened.cache_clear()
    monkeypatch.setattr(bag_sqlite3, "_STEPS_A_BYTE", bag_sqlite3._STEPS_A_BYTE / 100)
    with pytest.raises(InputError, match="bag cannot be read: SQLite needs more steps for it than for any recording"):
        read_recording(tmp_path / "bag")


def test_messages_behind_a_damaged_page_are_recovered(tmp_path, recording):
    """Page by page; what SQLite cannot read is told."""
    path = tmp_path / "bag"
    write_recording(path, recording, "sqlite3")
    content = bytearray((path / "bag.db3").read_bytes())
    place = content.index(recording.readings_T[300, 0].tobytes()) // 4096 * 4096
    content[place : place + 4096] = b"\xff" * 4096
    (path / "bag.db3").write_bytes(content)
    with pytest.raises(InputError, match=r"is damaged or truncated: SQLite finds .*; `tam recover .* keeps"):
        read_recording(path)
    found = recover(path, tmp_path / "new")
    assert found.faults[0].startswith("SQLite cannot read on behind message 14") and len(found.faults) == 1
    again = read_recording(tmp_path / "new")
    assert 560 < again.sample_count < 600
    assert np.isin(again.time_s, recording.time_s).all() and again.time_s[-1] == recording.time_s[-1]
