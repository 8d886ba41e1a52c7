"""The diagnostics of a solve, and the refusal of an answer that is not converged."""

from dataclasses import dataclass


@dataclass(frozen=True)
class SolveResult:
    """What a solve of a Signorini problem took, and how good its answer is.

    For example, after `problem.solve()`:

        print(problem.result.reason, problem.result.natural_residual)

    Attributes:
        method: The solver.
        reason: Why the solver stopped, in words.
        iterations: The iterations of TAO.
        linear_solves: The linear solves of the active set method, without the rough ones of an
            obstacle in the domain; 0 where TAO did everything.
        linear_iterations: The iterations of the linear solver, inside of TAO included.
        natural_residual: The natural residual relative to the data.
        active_dofs: The number of contact dofs with u = g.
        preconditioner: What the linear solver took for the inverse of the matrix, in words:
            "cholesky", multigrid with its levels, or the type of PETSc, for example "boomeramg".
            Empty where TAO did everything.
        setups: The set-ups of the preconditioner, or factorizations, of this solve.
        seconds: The wall-clock seconds of each phase.
        algebraic_share: The estimate of the algebraic error over that of the discretisation error,
            where the solve stopped by this; None where the natural residual decided.
    """

    method: str
    reason: str
    iterations: int
    linear_solves: int
    linear_iterations: int
    natural_residual: float
    active_dofs: int
    seconds: dict[str, float]
    preconditioner: str = ""
    setups: int = 0
    algebraic_share: float | None = None
