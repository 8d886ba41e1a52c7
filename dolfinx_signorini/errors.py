"""The exceptions of this package, and how one rank's failure becomes every rank's."""

from mpi4py import MPI


class InputError(ValueError):
    """The problem as posed cannot be solved; the message names the input that is wrong."""


class NotConvergedError(RuntimeError):
    """A solver ended without the accuracy asked for.

    Attributes:
        residual: The relative natural residual that was reached.
        reason: Why the solver stopped, in words.
    """

    def __init__(self, message: str, residual: float, reason: str):
        super().__init__(message)
        self.residual = residual
        self.reason = reason


def require(comm: MPI.Comm, satisfied: bool, message: str) -> None:
    """Raise an InputError on every rank unless the condition holds on every rank.

    Args:
        comm: The communicator; the call is collective.
        satisfied: What this rank found.
        message: What is wrong; the first failing rank's is raised everywhere.
    """
    for failure in comm.allgather(None if satisfied else message):
        if failure is not None:
            raise InputError(failure)
