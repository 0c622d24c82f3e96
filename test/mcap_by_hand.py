"""Mcap files laid out by hand, as the specification says: independent of the readers and of rosbags."""

import struct

MAGIC = b"\x89MCAP0\r\n"


def record(kind, *parts):
    """Return a record."""
    content = b"".join(parts)
    return struct.pack("<BQ", kind, len(content)) + content


def text(value):
    """Return a text, or bytes, as mcap stores them."""
    content = value.encode() if isinstance(value, str) else value
    return struct.pack("<I", len(content)) + content


def mcap(profile, topics, messages, indexed=True):
    """Return a file of one chunk.

    Parameters
    ----------
    profile : str
        Of the header.
    topics : list of (topic, type, schema encoding, definition, message encoding)
        Channels 1, 2, …, each with a schema of its own.
    messages : list of (channel, recorded_ns, bytes)
        In the order of the file.
    indexed : bool
        Whether the file has a summary with an index of the chunk.
    """
    described = b""
    for number, (topic, name, encoding, definition, serialisation) in enumerate(topics, 1):
        described += record(3, struct.pack("<H", number), text(name), text(encoding), text(definition))
        described += record(4, struct.pack("<HH", number, number), text(topic), text(serialisation), text(b""))
    content, places = described, {}
    for channel, recorded_ns, message in messages:
        places.setdefault(channel, []).append((recorded_ns, len(content)))
        content += record(5, struct.pack("<HIQQ", channel, 0, recorded_ns, recorded_ns), message)
    times = [recorded_ns for _, recorded_ns, _ in messages]
    span = struct.pack("<QQ", min(times), max(times))
    data = MAGIC + record(1, text(profile), text("by hand"))
    place, size = len(data), struct.pack("<QQ", len(content), len(content))
    data += record(6, span, size[:8], struct.pack("<I", 0), text(""), size[8:], content)
    length, offsets = len(data) - place, b""
    for channel, entries in places.items():
        offsets += struct.pack("<HQ", channel, len(data))
        index = b"".join(struct.pack("<QQ", *entry) for entry in entries)
        data += record(7, struct.pack("<H", channel), text(index))
    behind = len(data) - place - length
    data += record(15, bytes(4))
    summary = described + record(
        8, span, struct.pack("<QQ", place, length), text(offsets), struct.pack("<Q", behind), text(""), size
    )
    counts = b"".join(struct.pack("<HQ", channel, len(entries)) for channel, entries in places.items())
    summary += record(11, struct.pack("<QHIIII", len(messages), len(topics), len(topics), 0, 0, 1), span, text(counts))
    footer = record(2, struct.pack("<QQI", len(data) if indexed else 0, 0, 0))
    return data + (summary if indexed else b"") + footer + MAGIC
