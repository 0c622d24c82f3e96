"""Run the `tam` command as ``python -m tam_calibration``."""

import signal


def run() -> None:
    """Run the command; Ctrl-C ends it without a traceback also while it loads, and when it has ended."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    from tam_calibration.cli.main import main

    main(prog_name="tam")


if __name__ == "__main__":
    run()
