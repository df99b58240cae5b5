"""One run of a study, from the open folder to the exit code."""

import contextlib
import dataclasses
from collections.abc import Mapping
from pathlib import Path

from rich.console import Console

from bo_tuner.backends import Backend
from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.backends.ros import RosBackend
from bo_tuner.confirmation import Recommendation, recommend
from bo_tuner.errors import JournalError, OutputError, RunError
from bo_tuner.interruption import Interrupted, Interruption
from bo_tuner.journal import Journal
from bo_tuner.methods import METHODS
from bo_tuner.progress import RunProgress, comparison
from bo_tuner.recommendation import Candidate, rank
from bo_tuner.recording.retention import RecordOptions
from bo_tuner.recording.run import RunRecording
from bo_tuner.run_folder import RunFolder, provenance
from bo_tuner.study import Study
from bo_tuner.trials import Cut, Value
from bo_tuner.tuning import Tuning
from bo_tuner.validation import Validation, validate

EXIT_OK = 0
EXIT_FAULT = 1
EXIT_USAGE = 2
EXIT_INFEASIBLE = 3
EXIT_SIGNAL = 128


class Session:
    """A run and its report.

    Parameters
    ----------
    study
        The study as run.
    algorithm
        Key of `METHODS`.
    output
        Where run folders are made.
    backend
        ``ros`` or ``inprocess``.
    interruption
        Ends the run on a signal.
    attach
        Use nodes that run already.
    ros_arguments
        ``--ros-args`` for the tuner's node and the ones that it starts.
    record
        What of the trials is recorded, on ROS; as in `RecordOptions` by default.
    """

    def __init__(
        self,
        study: Study,
        algorithm: str,
        output: Path,
        backend: str,
        interruption: Interruption,
        *,
        attach: bool = False,
        ros_arguments: list[str] | None = None,
        record: RecordOptions | None = None,
    ) -> None:
        self._study = study
        self._algorithm = algorithm
        self._method = METHODS[algorithm]
        self._output = output
        self._backend_name = backend
        self._interruption = interruption
        self._attach = attach
        self._ros_arguments = ros_arguments or []
        self._record = record or RecordOptions()
        # Reasons and units are shown as they are: what stands in brackets is no markup.
        self._console = Console(stderr=True, markup=False, emoji=False, highlight=False)

    def run(self) -> int:
        """Tune, validate and report; returns the exit code.

        Raises
        ------
        OutputError, BackendError, StudyError
            If the folder, the nodes or the objects cannot be had in the first place.
        """
        folder = RunFolder(self._output, self._study)
        record = provenance(self._study, self._backend_name, self._algorithm)
        try:
            with Journal(folder.journal, record) as journal:
                try:
                    code = self._run(self._make_backend(folder), journal, folder)
                except BaseException:
                    # What ended the run matters more than a table that cannot be written either.
                    with contextlib.suppress(JournalError):
                        journal.export_csv(folder.path)
                    raise
                journal.export_csv(folder.path)
                return code
        except Interrupted as interrupt:
            self._tell(f"interrupted by {interrupt}; the record stays in {folder.path}")
            return EXIT_SIGNAL + interrupt.signum
        except (RunError, JournalError, OutputError) as error:
            self._tell(f"error: {error}; the record stays in {folder.path}")
            return EXIT_FAULT

    def _run(self, backend: Backend, journal: Journal, folder: RunFolder) -> int:
        try:
            self._interruption.check()
            backend.open()
            folder.link_latest()
            self._tell(f"run folder {folder.path}")
            return self._tune(backend, journal, folder)
        finally:
            # The nodes come down first, whatever happens to the files.
            self._interruption.ignore()
            backend.close()

    def _make_backend(self, folder: RunFolder) -> Backend:
        if self._backend_name == "inprocess":
            return InProcessBackend(self._study)
        return RosBackend(
            self._study,
            folder.log,
            attach=self._attach,
            ros_arguments=self._ros_arguments,
            interrupted=self._interruption.check,
        )

    def _tune(self, backend: Backend, journal: Journal, folder: RunFolder) -> int:
        study = self._study

        def observe(cut: Cut, parameters: Mapping[str, Value]) -> None:
            journal.record_cut(cut, parameters)
            self._interruption.check()

        recording = self._recording(backend, folder)

        def observe_and_record(cut: Cut, parameters: Mapping[str, Value]) -> None:
            journal.record_cut(cut, parameters)
            recording.cut(cut, parameters)
            self._interruption.check()

        tuning = Tuning(study, backend, self._method, observe=observe_and_record)
        with RunProgress(self._console, study) as progress:
            progress.begin("tuning", study.budget.trials)
            with recording:
                for trial in tuning:
                    journal.record_trial(trial)
                    leader = self._best(tuning)
                    progress.trial(trial, leader)
                    recording.trial(
                        trial, leader is not None and leader.trial.number == trial.number
                    )
                    self._interruption.check()
            progress.begin("checking candidates", self._method.most_checked)
            best = recommend(
                study,
                backend,
                tuning.trials,
                self._method.models,
                most_checked=self._method.most_checked,
                observe=observe,
                advance=progress.advance,
            )
            if best is None:
                self._tell("no feasible parametrization: every trial failed")
                return EXIT_INFEASIBLE
            progress.begin("validation", study.budget.validation_draws)
            default, tuned = validate(
                study,
                backend,
                [study.search_space().defaults, best.candidate.trial.parameters],
                observe=observe,
                advance=progress.advance,
            )
        return self._report(folder, best, default, tuned, recording.summary)

    def _best(self, tuning: Tuning) -> Candidate | None:
        ranked = rank(self._study, tuning.trials, self._method.models)
        return ranked[0] if ranked else None

    def _recording(self, backend: Backend, folder: RunFolder) -> RunRecording:
        listen = backend.listen if isinstance(backend, RosBackend) else None
        return RunRecording(folder.path, self._study, self._record, listen, self._tell)

    def _report(
        self,
        folder: RunFolder,
        best: Recommendation,
        default: Validation,
        tuned: Validation,
        recorded: Mapping[str, object],
    ) -> int:
        feasible = best.feasible and tuned.feasible
        candidate = best.candidate
        path = folder.write_parameters(self._study, candidate.trial.parameters)
        folder.write_summary(
            {
                "feasible": feasible,
                "trial": candidate.trial.number,
                "checked_trials": best.checked,
                "predicted_objective": candidate.objective,
                "predicted_feasibility": candidate.feasibility,
                "default": dataclasses.asdict(default) | {"feasible": default.feasible},
                "tuned": dataclasses.asdict(tuned) | {"feasible": tuned.feasible},
                "recording": recorded,
            }
        )
        out = Console(markup=False, emoji=False, highlight=False)
        out.print(comparison(self._study, default, tuned))
        out.print(f"parameters: {path}", soft_wrap=True)
        if not best.feasible:
            out.print(
                "no parametrization is feasible as far as the checks can tell; the file holds the "
                "least violating one",
                soft_wrap=True,
            )
        elif not feasible:
            out.print(
                "the parametrization found looked feasible, but did not hold in the validation",
                soft_wrap=True,
            )
        return EXIT_OK if feasible else EXIT_INFEASIBLE

    def _tell(self, text: str) -> None:
        self._console.print(text, soft_wrap=True)
