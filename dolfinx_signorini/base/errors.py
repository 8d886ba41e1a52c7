"""The exceptions of this package, and how the failure of one rank becomes that of every rank."""

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Timer

from mpi4py import MPI

from dolfinx_signorini.base.logs import PATIENCE

INDEFINITE = "not positive definite"  # how messages about such forms begin


class InputError(ValueError):
    """The problem as posed cannot be solved.

    The text of the exception begins with the subject, for example "rtol: must lie between 0 and 1":

        try:
            problem.solve(rtol=2.0)
        except InputError as error:
            print(error.subject, error.message)

    Attributes:
        message: What is wrong.
        subject: The argument, option or part of a scene that is wrong; "" where no single one is.
        exit_code: What a command ends with.
    """

    exit_code = 2

    def __init__(self, message: str, subject: str = ""):
        super().__init__(f"{subject}: {message}" if subject else message)
        self.message, self.subject = message, subject


class NotConvergedError(RuntimeError):
    """A solver ended without the accuracy asked for.

    Attributes:
        message: What was reached and asked for.
        residual: The natural residual that was reached, relative to the data.
        reason: Why the solver stopped, in words.
        exit_code: What a command ends with.
    """

    exit_code = 3

    def __init__(self, message: str, residual: float, reason: str, advice: str = ""):
        super().__init__(f"{message}; {advice}" if advice else message)
        self.message, self.residual, self.reason = message, residual, reason


def option_name(argument: str) -> str:
    """Return what the command line calls an argument, as subjects of errors name an option."""
    return "--" + argument.replace("_", "-")


def require(comm: MPI.Comm, satisfied: bool, message: str, subject: str) -> None:
    """Raise an InputError on every rank unless the condition holds on every rank.

    Args:
        comm: The communicator; the call is collective.
        satisfied: What this rank found.
        message: What is wrong; the message of the first rank that failed is raised on all ranks.
        subject: The argument that is wrong.

    Raises:
        InputError: The condition fails on some rank.
    """
    for failure in comm.allgather(None if satisfied else message):
        if failure is not None:
            raise InputError(failure, subject)


@contextmanager
def together(comm: MPI.Comm, subject: str, failed: str = "") -> Iterator[None]:
    """Raise on every rank what a block raises on some: a function of a user is called in the block.

    For example:

        with together(comm, "on_step"):
            on_step(step)

    A rank raises its own exception; the ranks without one raise an InputError with the message of
    the first rank that has one. Where the function communicates, and others wait for the rank that
    failed inside of the function, nothing can be raised: then the rank tells at least what it has.

    Args:
        comm: The communicator; the call is collective.
        subject: The argument that the function was given as.
        failed: What an exception means, in words, where the rank with the exception is to raise an
            InputError, too.

    Raises:
        InputError: The block raised an exception on another rank.
    """
    failure: Exception | None = None
    told: tuple[str, str] | None = None
    try:
        yield
    except InputError as error:
        failure, told = error, (error.message, error.subject)
    except Exception as error:
        told = f"{failed or 'raised'} {type(error).__name__}: {error}", subject
        failure = error
        if failed:
            failure = InputError(*told)
            failure.__cause__ = error
    timer = Timer(PATIENCE, traceback.print_exception, [failure])
    timer.daemon = True
    if failure is not None:
        timer.start()
    found = comm.allgather(told)
    timer.cancel()
    if failure is not None:
        raise failure
    for message in found:
        if message is not None:
            raise InputError(*message)
