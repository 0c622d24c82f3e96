"""The command line as tests run it."""

from click.testing import CliRunner

from tam_calibration.cli.main import main


def tam(*words, code=0):
    """Run `tam` with words and return its result; it must end with a code."""
    result = CliRunner().invoke(main, list(map(str, words)))
    assert result.exit_code == code, (words, result.output, result.exception)
    return result
