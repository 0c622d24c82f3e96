"""Precedence of a process that must keep up with its sensors over those that only compute."""

import os
from pathlib import Path

from tam_calibration.nodes.node_parameters import Rule

LOWEST_PRIORITY = 1
"""Of the real-time priorities (1 to 99): above all that is not real-time, below all else that is."""

REAL_TIME = Rule("real_time", True, "Whether the process comes before all that is not real-time, where its user may.")


def precede() -> str:
    """Have the threads of this process, and those that they start, run before all that are not real-time.

    Returns
    -------
    str
        How the process is scheduled, for /diagnostics: as before where its user has no right to more.
    """
    try:
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(thread.name), os.SCHED_RR, os.sched_param(LOWEST_PRIORITY))
    except PermissionError:
        return "normal: this user may not use real-time priorities"
    return f"real-time, priority {LOWEST_PRIORITY}"
