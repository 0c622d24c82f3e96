"""Bytes that a disk, a transfer or a stopped recorder spoils."""

from collections.abc import Callable

from numpy.random import Generator

from battery.trial import pick

Damage = Callable[[bytes, Generator], bytes]


def _somewhere(data: bytes, rng: Generator, longest: int = 4096) -> tuple[int, int]:
    """Return where a part begins and ends."""
    begin = int(rng.integers(len(data) + 1))
    return begin, min(len(data), begin + int(rng.integers(1, longest)))


def one_byte(data: bytes, rng: Generator) -> bytes:
    """Change one byte."""
    place = int(rng.integers(len(data)))
    return data[:place] + bytes([data[place] ^ int(rng.integers(1, 256))]) + data[place + 1 :]


def bits(data: bytes, rng: Generator) -> bytes:
    """Flip some bits."""
    spoiled = bytearray(data)
    for place in rng.integers(len(data), size=rng.integers(1, 9)):
        spoiled[place] ^= 1 << int(rng.integers(8))
    return bytes(spoiled)


def cut(data: bytes, rng: Generator) -> bytes:
    """Lose the end, as a recorder does whose power goes."""
    return data[: int(rng.integers(len(data)))]


def without_beginning(data: bytes, rng: Generator) -> bytes:
    """Lose the beginning."""
    return data[int(rng.integers(1, len(data))) :]


def without_part(data: bytes, rng: Generator) -> bytes:
    """Lose a part between."""
    begin, end = _somewhere(data, rng)
    return data[:begin] + data[end:]


def with_noise(data: bytes, rng: Generator) -> bytes:
    """Hold random bytes for a part."""
    begin, end = _somewhere(data, rng)
    return data[:begin] + rng.bytes(end - begin) + data[end:]


def with_zeros(data: bytes, rng: Generator) -> bytes:
    """Hold zeros for a part, as a file system does after a crash."""
    begin, end = _somewhere(data, rng)
    return data[:begin] + bytes(end - begin) + data[end:]


def repeated(data: bytes, rng: Generator) -> bytes:
    """Hold a part twice."""
    begin, end = _somewhere(data, rng)
    return data[:end] + data[begin:]


def exchanged(data: bytes, rng: Generator) -> bytes:
    """Hold one part at the place of another."""
    (begin, end), (other, _) = _somewhere(data, rng), _somewhere(data, rng)
    return data[:begin] + data[other : other + end - begin] + data[end:]


def longer(data: bytes, rng: Generator) -> bytes:
    """Have something behind the end."""
    return data + rng.bytes(int(rng.integers(1, 4096)))


_COMMON = (one_byte, bits, cut)
_RARE = (without_beginning, without_part, with_noise, with_zeros, repeated, exchanged, longer)


def any_damage(rng: Generator) -> Damage:
    """Return one of the damages; half of the time one of the three that are common."""
    return pick(rng, _COMMON if rng.random() < 0.5 else _RARE)
