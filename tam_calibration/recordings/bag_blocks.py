"""Messages that come one by one, gathered into blocks."""

from collections.abc import Iterable, Iterator

from tam_calibration.messages.cdr import RawMessages

COUNT, _BYTES = 16_384, 8_000_000
"""Most messages and bytes of a block: larger ones leave the processor's caches."""


def gather(messages: Iterable[tuple[int, int, bytes]], size: float = 0.0) -> Iterator[tuple[RawMessages, int]]:
    """Yield blocks of messages, and the bytes read for each.

    Parameters
    ----------
    messages : iterable of (int, int, bytes)
        Number of the connection, time of recording in nanoseconds and serialised message.
    size : float
        Bytes of the file for each message.
    """
    rows: list[tuple[int, int, bytes]] = []
    bytes_gathered = 0
    for row in messages:
        rows.append(row)
        bytes_gathered += len(row[2])
        if len(rows) == COUNT or bytes_gathered > _BYTES:
            yield _block(rows), round(size * len(rows))
            rows, bytes_gathered = [], 0
    if rows:
        yield _block(rows), round(size * len(rows))


def _block(rows: list[tuple[int, int, bytes]]) -> RawMessages:
    numbers, times, messages = zip(*rows, strict=True)
    return RawMessages.of(numbers, times, messages)
