"""The command line: one command per job.

Exit codes: 0 done, 2 the input is refused, 3 a solver did not converge or the accuracy was not
reached, whose best solution is written, 130 interrupted, 143 terminated. Only rank 0 speaks; an
unexpected error on one rank ends all of them.
"""

import argparse
import logging
import os
import re
import signal
import sys
import threading
import traceback
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any, NoReturn

from mpi4py import MPI

from dolfinx_signorini.base.errors import InputError, NotConvergedError
from dolfinx_signorini.base.logs import listen, log
from dolfinx_signorini.base.records import versions
from dolfinx_signorini.commands.options import add_talk, completion
from dolfinx_signorini.commands.printing import Guarded

# Each is a module here, which loads when the job is named.
JOBS = {
    "solve": "solve a scene file and write its results",
    "sweep": "solve a scene file for several values of one key: a table and a plot",
    "check": "what a scene file needs and costs, without solving it",
    "reproduce": "the paper's experiment: both tables and the pictures",
    "theory": "the paper's statements as experiments, proven beside measured (over a minute)",
    "tradeoff": "speed against accuracy: errors and seconds on a grid of meshes (some minutes)",
}
STOPS = (signal.SIGINT, signal.SIGTERM)


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are InputErrors, so that one rank reports them for all.

    What begins as a negative number does is no option.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        # How -1e-3, -0.1*x and -(1 + x) begin.
        self._negative_number_matcher = re.compile(r"-[\d.(]")

    def error(self, message: str) -> NoReturn:
        if re.search(r"VALUE|unrecognized.* -\w", message):
            message += "; a value that begins with a minus goes behind --"
        raise InputError(f"{message} (see {self.prog} --help)")


class _Completion(argparse.Action):
    """Prints a script for a shell, and ends."""

    def __call__(self, parser: argparse.ArgumentParser, *values: Any) -> NoReturn:
        print(completion(make_parser(), values[1]))
        parser.exit()


def make_parser(named: Collection[str] = tuple(JOBS)) -> argparse.ArgumentParser:
    """Return the parser of the command line, with all jobs.

    Args:
        named: The jobs whose arguments the parser knows; all by default.
    """
    parser = _Parser(
        prog="dolfinx-signorini",
        description="Signorini problems on FEniCSx: solve, measure the error, compare.",
    )
    parser.add_argument(
        "--version",
        action="version",
        version=", ".join(f"{name} {number}" for name, number in versions().items()),
        help="print the versions of the program, of DOLFINx and of PETSc",
    )
    parser.add_argument(
        "--completion",
        action=_Completion,
        choices=("bash", "zsh", "tcsh"),
        help="print a script that completes commands and options in a shell",
    )
    add_talk(parser)
    parser.set_defaults(level=logging.INFO)
    jobs = parser.add_subparsers(dest="job", required=True, metavar="JOB", parser_class=_Parser)
    for name, summary in JOBS.items():
        job = jobs.add_parser(name, help=summary, description=summary)
        if name in named:
            module = import_module(f"dolfinx_signorini.commands.{name}")
            module.configure(job)
            job.set_defaults(run=module.run)
        add_talk(job)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run a job.

    Args:
        argv: Arguments without the program's name; those of the process by default.

    Returns:
        The exit code.
    """
    comm, stdout = MPI.COMM_WORLD, sys.stdout
    if comm.rank:  # --help and the like print on one rank only
        stdout = open(os.devnull, "w")  # noqa: SIM115
    if threading.current_thread() is threading.main_thread():
        # PETSc would abort where a reader has gone.
        signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    sys.stdout = guarded = Guarded(stdout)  # type: ignore[assignment]
    handler = None
    level = log.level
    try:
        with _stoppable():
            words = sys.argv[1:] if argv is None else argv
            args = make_parser(JOBS.keys() & set(words)).parse_args(words)
            handler = listen(args.level)
            code = int(args.run(args))
            guarded.flush()
        if guarded.failure:
            raise InputError(f"cannot be written: {guarded.failure}", "standard output")
        return code
    except (InputError, NotConvergedError) as error:
        if comm.rank == 0:
            print(f"error: {error}", file=sys.stderr, flush=True)
        return error.exit_code
    except KeyboardInterrupt as stop:
        code = 128 + (stop.args[0] if stop.args else signal.SIGINT)
        if stop.args and comm.size > 1:
            comm.Abort(code)  # the others may have had no signal, and wait
        return code
    except Exception:
        traceback.print_exc()
        if comm.size == 1:
            return 1
        sys.stderr.flush()
        comm.Abort(1)
        raise
    finally:
        sys.stdout = stdout
        if handler is not None:
            log.removeHandler(handler)
        log.setLevel(level)


@contextmanager
def _stoppable() -> Iterator[None]:
    """Raise a KeyboardInterrupt where a signal stops the block, so that unfinished files go."""
    stopped: list[int] = []

    def stop(number: int, frame: Any) -> NoReturn:
        stopped.append(number)
        for each in before:  # a shell may send a signal twice: nothing disturbs the cleaning up
            signal.signal(each, signal.SIG_IGN)
        raise KeyboardInterrupt(number)

    alone = threading.current_thread() is threading.main_thread()
    before = {number: signal.getsignal(number) for number in STOPS if alone}
    before = {number: old for number, old in before.items() if old not in (None, signal.SIG_IGN)}
    try:
        for number in before:
            signal.signal(number, stop)
        yield
    except Exception as error:
        if stopped:  # in a function that PETSc calls, which tells of an error of its own
            raise KeyboardInterrupt(*stopped) from error
        raise
    finally:
        for number, old in before.items():
            signal.signal(number, old)
