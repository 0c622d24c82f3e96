"""A result is read as it was written, and a recording that has changed is known."""

import os

import pytest

from tam_calibration.fleet.task import RESULT, Result, Seal, read_result, state_of, write_result
from tam_calibration.recordings import provenance

FULL = Result(
    "dive",
    "auv",
    "/missions/auv/dive",
    "refused",
    {"calibrate": "the sensor turned about one axis"},
    "0f",
    Seal(12, 1_700_000_000_123_456_789, "ab"),
    600,
    (1.7e9, 1.7e9 + 6),
    ({"sensor": 1, "scale_factor": [1.0, 1.0, 1.0]},),
    {"verdict": "explained", "statement": "It drifts.", "before": 2.0, "after": 0.1, "closed": 0.99, "causes": ["lag"]},
    "corrected.csv",
)


@pytest.mark.parametrize("result", [FULL, Result("dive", "auv", "/missions/auv/dive", "failed", {"read": "no"}, "0f")])
def test_a_result_is_read_as_it_was_written(tmp_path, result):
    """With everything and with next to nothing."""
    write_result(tmp_path, result)
    assert read_result(tmp_path) == result


TEXTS = [None, "", "{", "[]", "{}", '{"schema": "tam_calibration/batch_result/0"}', "[" * 200_000]


@pytest.mark.parametrize("text", TEXTS, ids=lambda each: str(each)[:20])
def test_a_damaged_result_is_none(tmp_path, text):
    """What is no result, or one of another version, counts as if it were not there."""
    if text is not None:
        (tmp_path / RESULT).write_text(text)
    assert read_result(tmp_path) is None


@pytest.mark.parametrize(
    ("old", "new"),
    [('"samples": 600', '"samples": "x"'), ("1700000006", "1700000005"), ('"sensor": 1', '"sensor": []')],
)
def test_a_result_that_was_changed_is_none(tmp_path, old, new):
    """It holds its digest: a recording is rather worked through again than summed up by other numbers."""
    write_result(tmp_path, FULL)
    text = (tmp_path / RESULT).read_text()
    assert old in text
    (tmp_path / RESULT).write_text(text.replace(old, new))
    assert read_result(tmp_path) is None


@pytest.mark.parametrize(
    ("status", "verdict", "settled"),
    [
        ("done", "no_gap", True),
        ("done", "explained", True),
        ("done", "partly_explained", False),
        ("refused", "", False),
    ],
)
def test_settled_is_done_without_an_open_gap(status, verdict, settled):
    """A gap that is explained in part, or not at all, stays open."""
    result = Result("dive", "auv", "/dive", status, {}, "0f", gap={"verdict": verdict} if verdict else None)
    assert result.is_settled is settled


@pytest.mark.parametrize("name", ["auv_1/dive_0.csv", "auv_2/dive_2"])
def test_the_seal_holds_until_the_content_changes(folder, name):
    """Another time of the same content does not break it; another content does, of the same size too."""
    path = folder / "missions" / name
    seal = Seal(*state_of(path), provenance(path).sha256)
    part = next(path.glob("*.db3")) if path.is_dir() else path
    assert seal.holds(path)
    os.utime(part, ns=(0, seal.modified_ns + 1_000_000_000))
    assert seal.holds(path)
    content = bytearray(part.read_bytes())
    content[-1] ^= 1
    part.write_bytes(content)
    os.utime(part, ns=(0, seal.modified_ns + 2_000_000_000))
    assert not seal.holds(path)
    part.write_bytes(content[:-1])
    assert not seal.holds(path)
