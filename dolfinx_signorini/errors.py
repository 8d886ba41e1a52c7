"""The exceptions of this package, and how the failure of one rank becomes that of every rank."""

from mpi4py import MPI


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
    """

    def __init__(self, message: str, subject: str = ""):
        super().__init__(f"{subject}: {message}" if subject else message)
        self.message, self.subject = message, subject


class NotConvergedError(RuntimeError):
    """A solver ended without the accuracy asked for.

    Attributes:
        residual: The natural residual that was reached, relative to the data.
        reason: Why the solver stopped, in words.
    """

    def __init__(self, message: str, residual: float, reason: str):
        super().__init__(message)
        self.residual = residual
        self.reason = reason


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
