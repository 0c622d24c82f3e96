"""What is logged while a command runs: said at its end, or in the sentence that ends it."""

import logging
from types import TracebackType

import click

from tam_calibration.model.exceptions import InputError, Refused


class HeldWarnings(logging.Handler):
    """Holds the warnings of this package while it is entered; they go to stderr where nothing is refused."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._sentences: dict[str, None] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Hold a warning, once."""
        self._sentences[record.getMessage()] = None

    def after(self, problem: Exception) -> str:
        """Return what is wrong, and behind it in one sentence what was warned of."""
        return f"{problem} ({'; '.join(self._sentences)})" if self._sentences else str(problem)

    def __enter__(self) -> None:
        """Begin to hold what is logged."""
        logging.getLogger("tam_calibration").addHandler(self)

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Say what was held, unless the command ends in a sentence."""
        logging.getLogger("tam_calibration").removeHandler(self)
        if not isinstance(problem, InputError | Refused):
            for sentence in self._sentences:
                click.echo(sentence, err=True)
