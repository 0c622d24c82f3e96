"""How linear algebra uses the processors."""

import os


def use_one_thread() -> None:
    """Have linear algebra use one thread, by default: matrices here are small, and threads only wait.

    To be called before numpy is loaded.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
