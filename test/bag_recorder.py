"""A recorder that tests kill: it writes messages without end, and tells when so many are written."""

import sqlite3
import sys
from itertools import count
from pathlib import Path

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
TEXT = "std_msgs/msg/String"
TOPICS = ("/first", "/second")


def message(number):
    """Return the topic, time of recording and bytes of a message by its number, which its size depends on."""
    text = STORE.types[TEXT](f"{number} " * (1 + number % 97))
    return TOPICS[number % 2], 1_700_000_000_000_000_000 + 1_000_000 * number, bytes(STORE.serialize_cdr(text, TEXT))


def write_by(writer):
    """Return a function that writes a message by a writer of bags."""
    writer.open()
    connections = {topic: writer.add_connection(topic, TEXT, typestore=STORE) for topic in TOPICS}
    return lambda topic, *rest: writer.write(connections[topic], *rest)


def write_database(folder, journal_mode):
    """Return a function that writes a message to a database as ROS does, and ends a transaction now and then."""
    folder.mkdir()
    database = sqlite3.connect(folder / "bag_0.db3", isolation_level=None)
    database.execute(f"PRAGMA journal_mode = {journal_mode}")
    database.execute("PRAGMA cache_size = 10")  # pages, so that what is not committed reaches the file
    database.executescript(Sqlite3Writer.SQLITE_SCHEMA)
    for number, topic in enumerate(TOPICS):
        database.execute("INSERT INTO topics VALUES(?, ?, ?, 'cdr', '', '')", (number, topic, TEXT))
    written = count(1)

    def write(topic, *rest):
        if not database.in_transaction:
            database.execute("BEGIN")
        number = TOPICS.index(topic)
        database.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES(?, ?, ?)", (number, *rest))
        if next(written) % 700 == 0:
            database.execute("COMMIT")

    return write


def recorder(kind, path):
    """Return what writes a message to a bag of a kind."""
    match kind:
        case "rosbags sqlite3" | "rosbags mcap":
            plugin = StoragePlugin.MCAP if kind.endswith("mcap") else StoragePlugin.SQLITE3
            return write_by(Writer(path, version=9, storage_plugin=plugin))
        case "own sqlite3" | "own mcap":
            from tam_calibration.recordings.bag_writing import BlockWriter

            return write_by(BlockWriter(path, kind.split()[1]))
    return write_database(path, kind)


if __name__ == "__main__":
    write = recorder(sys.argv[1], Path(sys.argv[2]))
    for number in count():
        write(*message(number))
        if number == int(sys.argv[3]):
            print("enough", flush=True)
