"""The program `ndob-fmu`: it runs one command, and turns errors and interrupts into one line and an exit code."""

from __future__ import annotations

import argparse
import logging
import os
import sys
from collections.abc import Sequence
from contextlib import nullcontext, suppress
from typing import NoReturn

from ndob_fmu import __version__
from ndob_fmu.command_line.log_commands import add_log_commands
from ndob_fmu.command_line.model_commands import add_model_commands
from ndob_fmu.command_line.simulation_commands import add_simulation_commands
from ndob_fmu.command_line.study_commands import add_study_commands
from ndob_fmu.errors import NdobError
from ndob_fmu.support.interrupts import exit_code, interruptible, received
from ndob_fmu.support.progress import PATIENCE, shown_after
from ndob_fmu.support.temporary import remove_folders

_READER_GONE = 128 + 13  # SIGPIPE


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0, 1 if a check or a run failed, 2 if the input cannot be used.

    If a signal ended the command, the exit code is 128 plus the number of the signal.
    """
    with interruptible(terminate=True):
        try:
            return _run(arguments)
        finally:
            remove_folders()


def _run(arguments: Sequence[str] | None) -> int:
    options = command_parser().parse_args(arguments)
    logging.basicConfig(format="ndob-fmu: %(message)s", level=logging.WARNING)
    try:
        with shown_after(PATIENCE) if options.slow else nullcontext():
            code: int = options.run(options)
    except (Exception, KeyboardInterrupt) as error:
        interrupt = error if isinstance(error, KeyboardInterrupt) else received()
        if interrupt is not None:
            print("ndob-fmu: interrupted; no unfinished file is left", file=sys.stderr)
            return exit_code(interrupt)
        if not isinstance(error, NdobError):
            raise
        print(f"ndob-fmu: {error}", file=sys.stderr)
        return error.exit_code
    return code


def run_and_leave() -> NoReturn:
    """Run one command and end the process with its exit code; 141, as in a shell, if nobody reads the output any more.

    The process ends without Python's finalization. An FMU has loaded pythonfmu's binary, whose static state would be
    used after it was freed, and the process might abort after a successful run. Every file is closed by now.
    """
    with interruptible(terminate=True):  # up to the exit: a second Ctrl-C must not print a traceback
        try:
            code = _code_of_main()
        except KeyboardInterrupt as interrupt:  # before or after the command itself
            code = exit_code(interrupt)
        os._exit(code)


def _code_of_main() -> int:
    try:
        code = main()
        sys.stdout.flush()
    except SystemExit as end:  # argparse's --help, --version and usage errors
        code = end.code if isinstance(end.code, int) else 0
        with suppress(OSError):
            sys.stdout.flush()
    except BrokenPipeError:  # as in `ndob-fmu check … | head -1`
        code = _READER_GONE
    except OSError as error:
        if error.filename is not None:  # of a file, and not of the stream that is printed to
            raise
        code = 2
        with suppress(OSError):
            print(f"ndob-fmu: the output cannot be written: {error.strerror}", file=sys.stderr)
    with suppress(OSError):
        sys.stderr.flush()
    return code


def command_parser() -> argparse.ArgumentParser:
    """Return the parser of all commands; its result has ``run``, which takes the options and returns the exit code."""
    # argparse and not a richer library: --start-values takes any number of words, as in `fmpy simulate`.
    parser = argparse.ArgumentParser(
        prog="ndob-fmu", description="Nonlinear disturbance observer: check, design, build and simulate it as FMUs."
    )
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    add_model_commands(commands)
    add_log_commands(commands)
    add_simulation_commands(commands)
    add_study_commands(commands)
    return parser
