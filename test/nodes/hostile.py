"""Messages that no node may take harm from: of every type that the nodes read, by a seeded generator."""

import math
from collections.abc import Iterator

from battery.damaged_bytes import any_damage
from battery.trial import pick
from numpy.random import Generator

_NO_VALUES = (math.nan, math.inf, -math.inf)
_NO_STAMPS = ((0, 0), (2**31 - 1, 999_999_999), (-(2**31), 0), (-1, 4_000_000_000), (1, 0))


def hostile_messages(good: dict[str, object], rng: Generator) -> Iterator[tuple[str, object]]:
    """Yield topics and messages without end: one of the good ones made bad, or bytes that are none.

    Parameters
    ----------
    good : dict
        A message that is fine by each topic.
    rng : Generator
        Of what is made bad.
    """
    from rclpy.serialization import serialize_message

    serialised = {topic: bytes(serialize_message(message)) for topic, message in good.items()}
    topics = sorted(good)
    while True:
        topic = pick(rng, topics)
        if rng.random() < 0.5:
            yield topic, _broken(serialised[topic], rng)
        elif type(good[topic]).__name__ == "String":
            yield topic, type(good[topic])(data=hostile_text(good[topic].data, rng))
        else:
            yield topic, _nonsense(serialised[topic], type(good[topic]), rng)


def _broken(message: bytes, rng: Generator) -> bytes:
    """Return bytes that no reader can take for the message: too short for its numbers, or of another encoding."""
    way = int(rng.integers(3))
    if way == 0:
        return message[: int(rng.integers(len(message) // 2))]
    if way == 1:
        return b"\x00\x01\x00\x00" + b"\xff" * int(rng.integers(min(200, len(message) - 4)))
    return rng.bytes(int(rng.integers(1, 12)))


def _nonsense(serialised: bytes, kind: type, rng: Generator) -> object:
    """Return a message that can be read and means nothing."""
    from rclpy.serialization import deserialize_message

    message = deserialize_message(serialised, kind)
    if hasattr(message, "header"):
        sec, nanosec = pick(rng, _NO_STAMPS)
        message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
        message.header.frame_id = pick(rng, ("", "x" * 10_000, "é\n\x1b[2J", message.header.frame_id))
    value = pick(rng, _NO_VALUES)
    if kind.__name__ == "PointCloud2":
        _spoil_cloud(message, rng)
    elif kind.__name__ == "MagneticField":
        message.magnetic_field.y = value
    elif kind.__name__ == "Imu":
        message.orientation.x, message.orientation_covariance[0] = value, value
    elif kind.__name__ == "Temperature":
        message.temperature = value
    else:
        message.data = value
    return message


def _spoil_cloud(cloud, rng: Generator) -> None:
    """Let what a cloud says of its columns and what it holds not go together."""
    way = int(rng.integers(6))
    field = cloud.fields[int(rng.integers(len(cloud.fields)))]
    if way == 0:
        cloud.point_step = int(rng.integers(2**32))
    elif way == 1:
        cloud.width, cloud.height = (int(each) for each in rng.integers(2, 2**32, size=2))
    elif way == 2:
        cloud.data = rng.bytes(int(rng.integers(2000)) * 8 + 3)
    elif way == 3:
        field.offset, field.count = (int(each) for each in rng.integers(1000, 2**32, size=2))
    elif way == 4:
        field.name = pick(rng, ("", "b999999999x", "x" * 10_000, cloud.fields[0].name + "_"))
    else:
        field.datatype = int(rng.integers(9, 255))


def hostile_text(good: str, rng: Generator) -> str:
    """Return text that is no calibration, some of it made to end what reads it."""
    count = int(10 ** rng.uniform(2, 5))
    token = pick(rng, ("!!bool abc", "!!timestamp abc", ":".join(["1"] * 500) + ".5", ".nan", "1e300", "on", "1:30"))
    key = pick(rng, ("scale_factor", "bias_nT", "sensors", "method", "positions_m", "schema"))
    lines = good.split("\n")
    place = next(number for number, line in enumerate(lines) if key in line)
    lines[place] = lines[place].partition(":")[0] + f": {token}"
    return pick(
        rng,
        (
            *(
                "[" * count,
                "{" * count,
                "- " * count,
                "&a [*a]",
                "!!python/object/apply:os._exit [1]",
                "\0",
                "",
                "x" * count,
            ),
            *(f"a: {token}", "\n".join(lines), "a0: &a0 [x, x]\n" + _laughs(), ": " * count, "'" * (count | 1)),
            any_damage(rng)(good.encode(), rng)[: len(good) // 2].decode(errors="ignore").replace("\0", ""),
        ),
    )


def _laughs() -> str:
    return "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 12))


def own_memory_bytes(process: int) -> int:
    """Return the resident memory that is a process's own, without what it shares with those that write to it."""
    with open(f"/proc/{process}/status") as file:
        return next(1024 * int(line.split()[1]) for line in file if line.startswith("RssAnon:"))
