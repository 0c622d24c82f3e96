"""Shared memory that killed nodes left does not stop later tests."""

import pytest
from ros_domains import remove_leftovers


@pytest.mark.parametrize(("mapped", "left"), [("/dev/shm/fastrtps_port7013", 2), ("/usr/lib/libc.so.6", 0)])
def test_memory_is_removed_where_no_process_uses_any(tmp_path, mapped, left):
    """Files of others stay, and all stay while one process still uses some; one that has ended meanwhile is none."""
    memory, processes = tmp_path / "shm", tmp_path / "proc"
    for folder in (memory, processes / "12", processes / "13"):
        folder.mkdir(parents=True)
    (processes / "12" / "maps").write_text(f"7f0-7f1 rw-s 0 00:1a 7 {mapped}\n")
    for name in ("fastrtps_port7013", "sem.fastrtps_port7013_mutex", "other"):
        (memory / name).touch()
    remove_leftovers(memory, processes)
    assert (memory / "other").exists()
    assert len(list(memory.glob("*fastrtps_*"))) == left
