"""Run the `tam` command as ``python -m tam_calibration``."""

from tam_calibration.cli.main import main

main(prog_name="tam")
