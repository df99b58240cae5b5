"""What the commands return to the shell."""

from typing import TYPE_CHECKING

from bo_tuner.interruption import Interrupted

if TYPE_CHECKING:
    from bo_tuner.evidence.verdict import Verdict

EXIT_OK = 0
EXIT_FAULT = 1
EXIT_USAGE = 2
EXIT_INFEASIBLE = 3
EXIT_SIGNAL = 128
"""Plus the number of the signal."""


def early_end(error: BaseException) -> tuple[str, int]:
    """Return what to say of that which ends a run or a certificate early, and the exit code."""
    if isinstance(error, Interrupted):
        return f"interrupted by {error}", EXIT_SIGNAL + error.signum
    return f"error: {error}", EXIT_FAULT


def exit_code(verdict: "Verdict") -> int:
    """Return what a command that has come to a verdict returns."""
    # It imports NumPy, which an entry point does not before it has seen to signals.
    from bo_tuner.evidence.verdict import State

    if verdict.state is State.INCOMPLETE:
        return EXIT_FAULT
    return EXIT_OK if verdict.feasible else EXIT_INFEASIBLE
