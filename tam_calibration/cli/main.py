"""The `tam` command: one group, its subcommands loaded when they are called.

It prints notes when they are logged, and warnings at its end or in the sentence that ends it.
"""

import logging
import sys
from importlib import import_module
from importlib.util import find_spec
from types import TracebackType
from typing import Any

import click
from click.shell_completion import CompletionItem

from tam_calibration import __version__
from tam_calibration.cli.streams import GradedBad, on_one_line, say, tell, usable_streams
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.libraries import use_one_thread
from tam_calibration.model.signals import Ending

_LOGGER = logging.getLogger("tam_calibration")


class HeldWarnings(logging.Handler):
    """Prints notes of this package on stderr while it is entered, and its warnings once nothing is refused."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self._sentences: dict[str, None] = {}
        self._notes: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        """Hold a warning, or tell a note, each once."""
        sentence = record.getMessage()
        if record.levelno >= logging.WARNING:
            self._sentences[sentence] = None
        elif sentence not in self._notes:
            self._notes.add(sentence)
            say(sentence, err=True)

    def after(self, problem: Exception) -> str:
        """Return what is wrong, and behind it in one sentence what was warned of."""
        return f"{problem} ({'; '.join(self._sentences)})" if self._sentences else str(problem)

    def __enter__(self) -> None:
        """Begin to hear what is logged."""
        self._level = _LOGGER.level
        _LOGGER.setLevel(logging.INFO)
        _LOGGER.addHandler(self)

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Say what was held, unless the command ends in a sentence."""
        _LOGGER.removeHandler(self)
        _LOGGER.setLevel(self._level)
        if not isinstance(problem, InputError | Refused):
            for sentence in self._sentences:
                say(sentence, err=True)


SUBCOMMANDS = {
    "simulate": "Make a recording of a known array and field, and write the truth too.",
    "inspect": "Show what a recording contains, what is odd, and what is taken as sensors.",
    "calibrate": "Estimate the errors of an array's sensors from a recording.",
    "diagnose": "Find what a recording contains beyond model and noise, and which effect causes it.",
    "compare": "Compare a simulator's recording with a real one, and write corrections for the simulator.",
    "plan": "Propose the attitudes to record next, and what the standard errors will then be.",
    "correct": "Turn raw readings into the centre vector and the gradient tensor.",
    "export": "Write a calibration for PX4, ArduPilot, imu_tools, MicroStrain, C or JSON.",
    "recover": "Write the readable messages of an unfinished or damaged bag to a new one.",
    "locate": "Locate the source in a recording, steady or alternating.",
    "batch": "Calibrate, diagnose and correct many recordings, on all cores or on a Dask cluster.",
    "nodes": "Start the nodes: collector, calibrator, corrector, localizer.",
    "play": "Play a bag onto its topics, to feed the nodes.",
    "call": "Call a service of the nodes, such as calibrator/calibrate.",
}

VALIDATION = {
    "demo": "Run the complete chain over ROS 2 and show what it gained.",
    "blind": "Check the diagnosis on recordings whose cause is withheld: make, answer, score.",
    "reproduce": "Run the simulations of the papers again, number by number.",
}
"""Subcommands of the package `tam_validation`, which a checkout has next to this one and which is not installed."""

_IN_NODES = ("play", "call")
"""Subcommands in the file of `tam nodes`, each a function of its name."""


def subcommands() -> dict[str, str]:
    """Return the subcommands that there are, each with what it does."""
    return SUBCOMMANDS | (VALIDATION if find_spec("tam_validation") else {})


class LazyGroup(click.Group):
    """A group whose subcommand NAME is ``tam_calibration.cli.NAME.command``, imported when called."""

    def main(self, *args: Any, **extra: Any) -> Any:
        """Run the command; a signal ends it in order, with the exit code that shells have for it.

        Parameters
        ----------
        *args, **extra
            As of click.
        """
        use_one_thread()
        with usable_streams():
            ending = Ending()
            try:
                return super().main(*args, obj=ending, **extra)
            finally:
                if ending.told is not None:
                    sys.exit(ending.told)  # also where Python could not raise it, or a library took it for a failure
                ending.release()

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in the order in which they are used."""
        return list(subcommands())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a subcommand; None where there is none of that name.

        Parameters
        ----------
        ctx : Context
            Of the group; not used.
        cmd_name : str
            Name as the user typed it.
        """
        if cmd_name not in subcommands():
            return None
        module, name = f"tam_calibration.cli.{cmd_name}", "command"
        if cmd_name in VALIDATION:
            module = f"tam_validation.{cmd_name}_command"
        elif cmd_name in _IN_NODES:
            module, name = "tam_calibration.cli.nodes", cmd_name
        command: click.Command = getattr(import_module(module), name)
        if isinstance(ctx.obj, Ending):
            ctx.obj.loaded()
        return command

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Return the names that begin so, without importing the subcommands.

        Parameters
        ----------
        ctx : Context
            Of the group.
        incomplete : str
            What is typed.
        """
        names = {name: words for name, words in subcommands().items() if name.startswith(incomplete)}
        options = click.Command.shell_complete(self, ctx, incomplete)
        return [*(CompletionItem(name, help=words) for name, words in names.items()), *options]

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of subcommands without importing them.

        Parameters
        ----------
        ctx : Context
            Of the group; not used.
        formatter : HelpFormatter
            Of the help text, to which the list is added.
        """
        with formatter.section("Commands"):
            formatter.write_dl(list(subcommands().items()))

    def invoke(self, ctx: click.Context) -> Any:
        """Run a subcommand; input errors become one sentence, with the warnings, and an exit code."""
        held = HeldWarnings()
        try:
            with held:
                return super().invoke(ctx)
        except (click.NoSuchOption, click.BadParameter) as problem:
            raise _on_one_line(problem) from None
        except click.UsageError as problem:
            raise _on_one_line(problem) if type(problem) is click.UsageError else problem from None
        except GradedBad as problem:
            problem.say(held.after(problem))
            ctx.exit(1)
        except Refused as problem:
            _end(ctx, held.after(problem), code=1)
        except InputError as problem:
            _end(ctx, held.after(problem), code=2)
        except BrokenPipeError:
            raise
        except OSError as problem:
            where = "" if problem.filename is None else f"{problem.filename}: "
            _end(ctx, where + (problem.strerror or str(problem)), code=2)
        except MemoryError:
            _end(ctx, "this needs more memory than there is: give fewer samples or sensors", code=2)


def _on_one_line(problem: click.UsageError) -> click.UsageError:
    """Return an error that quotes what was typed, which may have lines."""
    return click.UsageError(on_one_line(problem.format_message()), problem.ctx)


def _end(ctx: click.Context, sentence: str, code: int) -> None:
    tell(sentence)
    ctx.exit(code)


def _today(option: str) -> str:
    """Return the present name of an option that had another one."""
    return {"out": "output", "output-dir": "output"}.get(option, option)


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "token_normalize_func": _today})
@click.version_option(__version__, prog_name="tam")
def main() -> None:
    """Calibrate arrays of tri-axial magnetometers, offline and over ROS 2.

    Exits 0 when done, 1 when the answer is no (refused, with the reason), 2 on bad input, 130 after Ctrl-C, 143 after
    SIGTERM.
    """
