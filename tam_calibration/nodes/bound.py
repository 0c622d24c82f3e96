"""``python bound.py PID ARGUMENTS…`` runs Python with these arguments, and ends it in order when its parent PID ends.

A program of its own, as code between fork and exec could deadlock in a parent that has threads.
"""

import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1


def _bind(parent: int) -> None:
    """Have the kernel send SIGTERM when the thread that started this process has ended, also after exec."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:  # it ended before it was asked for
        sys.exit(0)


if __name__ == "__main__":
    _bind(int(sys.argv[1]))
    os.execv(sys.executable, [sys.executable, *sys.argv[2:]])
