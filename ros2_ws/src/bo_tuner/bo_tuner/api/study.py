"""A study as a Python object, and what can be done with it."""

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Self

from bo_tuner.api.earlier import EarlierRun
from bo_tuner.api.entries import plain
from bo_tuner.api.result import Result
from bo_tuner.api.run import TemporaryFolder
from bo_tuner.api.tuner import Tuner, opened
from bo_tuner.backends.function import Function
from bo_tuner.backends.passed_function import backend_of, workers_of
from bo_tuner.codec import checks
from bo_tuner.errors import StudyError
from bo_tuner.study import study as checked
from bo_tuner.study.function_study import FUNCTION, returned_metrics, with_function
from bo_tuner.study.study_file import load_study, study_from_mapping, study_to_yaml
from bo_tuner.trials import Value
from bo_tuner.tuning.observer import NOBODY, RunObserver


class Study:
    """What is tuned: parameters, contexts, metrics, objective, limits and budget.

    The arguments are the sections of a study file, as objects or as the dictionaries that a file
    would have; ``docs/study_file.md`` describes them.

    Parameters
    ----------
    name
        Short name.
    parameters
        Tuned parameters by name: `Double`, `Integer`, `Boolean`, `Choice`; as dictionaries also
        tied and fixed ones.
    metrics
        What a run has as its result: names, or by name a dictionary such as ``{"unit": "rad"}``.
    objective
        Name of the metric to be minimized, an expression of metrics, or an `Objective`.
    budget
        A `Budget`: how many trials there are.
    contexts
        What varies from run to run, by name: `Uniform`, `Beta`, `TruncatedNormal`, `Triangular` or
        `Discrete`.
    constraints
        Limits by name: `Chance`, `WorstCase`.
    sections
        Further sections: `further_objectives`, `measured`, `certificate`, `order`, `where`,
        `start`, `seed`, `description`.

    Raises
    ------
    StudyError
        If something is wrong with it: one line with the place, what was expected and what was
        found.
    """

    def __init__(
        self,
        *,
        name: str,
        parameters: Mapping[str, object],
        metrics: Mapping[str, object] | Sequence[str],
        objective: object,
        budget: object,
        contexts: Mapping[str, object] | None = None,
        constraints: Mapping[str, object] | None = None,
        **sections: object,
    ) -> None:
        given = {
            "name": name,
            "parameters": parameters,
            "metrics": _by_name(metrics),
            "objective": objective,
            "budget": budget,
            "contexts": {} if contexts is None else contexts,
            "constraints": {} if constraints is None else constraints,
            **sections,
        }
        with _with_other_problems():
            try:
                content = plain(given)
            except RecursionError:
                raise StudyError("a part of it has itself as a part") from None
            self._study = study_from_mapping(with_function(content))
        returned_metrics(self._study)

    @classmethod
    def from_yaml(cls, path: str | Path) -> Self:
        """Read a study file, with or without nodes, or a study that comes along, by its name.

        Raises
        ------
        StudyError
            If it cannot be read, something is wrong with it, or its metrics are not reported but
            computed from signals, which a function does not have.
        """
        with _with_other_problems():
            study = load_study(path, of_function=True)
        returned_metrics(study)
        made = cls.__new__(cls)
        made._study = study
        return made

    @property
    def name(self) -> str:
        """Its name."""
        return self._study.name

    @property
    def checked(self) -> checked.Study:
        """The study as the rest of the program has it; not part of the interface."""
        return self._study

    @property
    def defaults(self) -> dict[str, Value]:
        """The hand-tuned values of all parameters."""
        return dict(self._study.search_space().defaults)

    def to_yaml(self) -> str:
        """Return the text of a study file with the same study."""
        return study_to_yaml(self._study)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Study) and self._study == other._study

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"<Study {self.name}: {', '.join(self._study.parameters)}>"

    def optimize(
        self,
        function: Function,
        folder: str | Path | None = None,
        *,
        algorithm: str | None = None,
        workers: int | None = None,
        window: int | None = None,
        timeout: float | None = None,
        progress: bool = True,
        earlier: Iterable[EarlierRun] = (),
    ) -> Result:
        """Tune a function, from its first trial to the validation of the result.

        Parameters
        ----------
        function
            Called as ``function(parameters, context, seed)`` with two dictionaries and an integer;
            returns a number for each metric, by name, or raises `Failed`. Another exception is a
            failed run, too; Ctrl-C ends the tuning, and the next call with the same folder goes on.
        folder
            Of the run; one that exists is continued. Without it, nothing is kept beyond the result.
        algorithm
            As ``--algorithm`` of ``tune``; unless given that of the run, or the default.
        workers
            Number of runs at once, each in a process of its own, to which the function is passed;
            unless given ``budget.workers`` of the study, or 1.
        window
            How many trials are planned at once; the result depends on it and not on the workers.
            Unless given that of the run, or as many as there are workers.
        timeout
            Longest time [s] of a run, which is then in a process of its own; one that takes longer
            is ended, and is a failed run.
        progress
            Whether a line for each trial goes to standard error, on a terminal with a bar.
        earlier
            Runs that were made before, by whatever, which the run begins with. Those of one
            parameter set are a trial, and the budget counts them; a run that is continued has them.

        Returns
        -------
        Result
            The result of the run.

        Raises
        ------
        MetricsError
            If the function returns something else than a number for each metric.
        FunctionError
            If it cannot be called with these arguments, or is to run in another process, and cannot
            be passed there.
        BackendError, MissingPackageError
            If the workers cannot be started, or packages for them are not installed.
        RunRecordError, OutputError, JournalError
            As `tuner`.
        """
        count = workers_of(self._study, workers)
        backend = backend_of(self._study, function, count, timeout)
        if window is None:
            window = count
        with contextlib.ExitStack() as stack:
            display = NOBODY
            if progress:
                display = stack.enter_context(_progress(self._study, folder))
            tuner = self._opened(
                folder, algorithm, window, by_backend=True, display=display, earlier=earlier
            )
            stack.enter_context(tuner).carry_out(backend)
            return tuner.result()

    def tuner(
        self,
        folder: str | Path | None = None,
        *,
        algorithm: str | None = None,
        window: int = 1,
        earlier: Iterable[EarlierRun] = (),
    ) -> Tuner:
        """Begin or continue a run whose evaluations are asked for and told.

        Parameters
        ----------
        folder, algorithm, earlier
            As in `optimize`.
        window
            How many trials are planned at once: with more than one, several runs can be asked for
            before the first is told. A run that is continued keeps the window that it has.

        Raises
        ------
        RunRecordError
            If the folder has the run of another study, of another algorithm or on nodes, or no run
            but something else.
        OutputError
            If it cannot be written to, or another process works in it.
        JournalError
            If the record cannot be read or written.
        """
        return self._opened(folder, algorithm, window, earlier=earlier)

    def _opened(
        self,
        folder: str | Path | None,
        algorithm: str | None,
        window: int,
        *,
        by_backend: bool = False,
        display: RunObserver = NOBODY,
        earlier: Iterable[EarlierRun] = (),
    ) -> Tuner:
        """Begin or continue a run, in a temporary folder if none is given; as `opened`."""
        temporary = None
        if folder is None:
            temporary = TemporaryFolder()
            folder = temporary.path / self.name
        return opened(
            self._study,
            Path(folder),
            algorithm,
            window,
            by_backend=by_backend,
            temporary=temporary,
            display=display,
            earlier=earlier,
        )


def _by_name(metrics: object) -> Mapping[str, object]:
    """Return metrics by name, those of a list of names without more."""
    if isinstance(metrics, Mapping):
        return metrics
    names = metrics if isinstance(metrics, list | tuple) else ()
    if not names or not all(isinstance(name, str) for name in names):
        raise StudyError(
            f"expected a list of names, or a mapping of names, found {checks.show(metrics)}",
            ("metrics",),
        )
    return {name: {} for name in names}


@contextlib.contextmanager
def _progress(study: checked.Study, folder: str | Path | None) -> Iterator[RunObserver]:
    """Show a run on standard error."""
    # What draws it takes its time to load.
    from bo_tuner.monitoring.display import plain_console
    from bo_tuner.monitoring.progress import RunProgress

    with RunProgress(plain_console(stderr=True), study) as display:
        if folder is not None:
            display.start(Path(folder), FUNCTION, "")
        yield display


@contextlib.contextmanager
def _with_other_problems() -> Iterator[None]:
    """Let a traceback show also what else is wrong with a study."""
    try:
        yield
    except StudyError as error:
        for other in error.others:
            error.add_note(str(other))
        raise
