"""The errors of this package; each also derives from the builtin that fits it best."""

from collections.abc import Sequence

KeyPath = tuple[str | int, ...]
"""Keys and list positions that lead to a value in a study file."""


class BoTunerError(Exception):
    """Base class of every error that this package raises on purpose."""


class PackageFilesError(BoTunerError, FileNotFoundError):
    """Files that are shipped with the package are missing from the installation."""


class ParameterError(BoTunerError, ValueError):
    """A parameter set or a context that does not belong to its space."""


class ConditionError(ParameterError):
    """A parameter set that breaks a condition between parameters.

    Parameters
    ----------
    condition : str
        The condition.
    values : str
        The values that the set has in it.
    """

    def __init__(self, condition: str, values: str) -> None:
        super().__init__(f"breaks the condition '{condition}': {values}")
        self.condition = condition


class StudyError(BoTunerError, ValueError):
    """A study that violates a rule; the message is one line.

    Parameters
    ----------
    problem : str
        What was expected and what was found.
    path : tuple of str and int
        Key path to the value, from the study's root or from the object that was checked.
    source : str
        Name of the study file; empty if the study does not come from a file.
    line : int, optional
        Line in the study file, from 1.
    others : sequence of StudyError
        What else is wrong with the same study.
    """

    def __init__(
        self,
        problem: str,
        path: KeyPath = (),
        source: str = "",
        line: int | None = None,
        others: "Sequence[StudyError]" = (),
    ):
        super().__init__(problem, path, source, line, tuple(others))
        self.problem = problem
        self.path = path
        self.source = source
        self.line = line
        self.others = tuple(others)

    def under(self, *keys: str | int) -> "StudyError":
        """Return the same error as seen from an outer object, `keys` above this one."""
        others = [error.under(*keys) for error in self.others]
        return StudyError(self.problem, (*keys, *self.path), self.source, self.line, others)

    def located(self, source: str, line: int | None) -> "StudyError":
        """Return the same error, without others, with the file and, where known, the line."""
        return StudyError(self.problem, self.path, source, line)

    def with_others(self, others: "Sequence[StudyError]") -> "StudyError":
        """Return the same error with what else is wrong."""
        return StudyError(self.problem, self.path, self.source, self.line, others)

    def __str__(self) -> str:
        source = f"{self.source}:{self.line}" if self.source and self.line else self.source
        return ": ".join(part for part in (source, dotted(self.path), self.problem) if part)


def dotted(path: KeyPath) -> str:
    """Return a key path as text, such as ``run.before[0]``."""
    text = ""
    for key in path:
        if isinstance(key, int):
            text += f"[{key}]"
        else:
            # A key comes from a file: it may be long or contain line breaks.
            shown = key if key.isprintable() else repr(key)[1:-1]
            text += ("." if text else "") + (shown if len(shown) <= 60 else f"{shown[:57]}...")
    return text


class BackendError(BoTunerError, RuntimeError):
    """The nodes or objects of a study cannot be started, found or loaded."""


class JournalError(BoTunerError, OSError):
    """The journal of a run cannot be written or read."""


class RunRecordError(BoTunerError, OSError):
    """The record of a run is missing, unreadable, or does not allow what was requested."""


class RunError(BoTunerError, RuntimeError):
    """A run cannot continue; its record is kept."""


class Failed(BoTunerError, RuntimeError):  # noqa: N818
    """Raised by a function that is tuned: the run failed for its parameters, for this reason."""


class MetricsError(BoTunerError, ValueError):
    """The result of a function or of a run is not a number for each metric."""


class FunctionError(BoTunerError, TypeError):
    """A function that cannot be called, or not in another process."""


class WindowFull(BoTunerError, RuntimeError):  # noqa: N818
    """No further run can be asked for until the result of one that was asked for is reported."""


class UnknownRunError(BoTunerError, LookupError):
    """The result of a run that nobody waits for: reported already, or of another tuner."""


class MissingPackageError(BoTunerError, ImportError):
    """A package that is installed only on request is missing."""


class MethodError(BoTunerError, ImportError):
    """A method that another package offers cannot be loaded."""


class OutputError(BoTunerError, OSError):
    """A file or folder of results cannot be written."""
