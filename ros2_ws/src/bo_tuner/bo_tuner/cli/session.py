"""One run of a study, from the open folder to the exit code."""

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping, Sequence

from bo_tuner.backends.factory import make_backend
from bo_tuner.backends.protocol import ROS, Backend
from bo_tuner.backends.recorded import RecordedEvaluations
from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.cli.deliverables import write_deliverables
from bo_tuner.cli.exit_codes import EXIT_FAULT, EXIT_INFEASIBLE, EXIT_OK, EXIT_SIGNAL
from bo_tuner.errors import JournalError, OutputError, RunError, RunRecordError
from bo_tuner.interruption import Interrupted, Interruption
from bo_tuner.monitoring.display import Output, Result
from bo_tuner.monitoring.monitor import Monitor
from bo_tuner.monitoring.node import LiveNode
from bo_tuner.monitoring.status import CHECKING, TUNING, VALIDATION
from bo_tuner.optimizers.algorithms import METHODS
from bo_tuner.optimizers.ranking import Candidate, rank
from bo_tuner.recording.retention import RecordOptions
from bo_tuner.recording.run_recording import RunRecording
from bo_tuner.storage.journal import Journal
from bo_tuner.storage.journal_reader import JournalContent, export_csv, salvage
from bo_tuner.storage.provenance import provenance
from bo_tuner.storage.run_folder import RunFolder
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Trial, Value
from bo_tuner.tuning.loop import Tuning
from bo_tuner.tuning.recommendation import Recommendation, recommend
from bo_tuner.tuning.validation import Validation, validate

NOTHING = JournalContent((), (), (), "")
STOP_EARLY = "stop_early"
"""Key of the provenance that tells of the option, so that a run goes on as it began."""


@dataclasses.dataclass(frozen=True)
class RunOptions:
    """How a run is run.

    Attributes
    ----------
    algorithm
        Key of `METHODS`.
    backend
        One of `BACKENDS`.
    attach
        Use nodes that run already.
    ros_arguments
        ``--ros-args`` for the tuner's node and the ones that it starts.
    record
        What of the trials is recorded, on ROS.
    output
        What is shown of the run.
    stop_early
        Follow the advice to stop.
    """

    algorithm: str = "IV"
    backend: str = ROS
    attach: bool = False
    ros_arguments: Sequence[str] = ()
    record: RecordOptions = dataclasses.field(default_factory=RecordOptions)
    output: Output = Output.PROGRESS
    stop_early: bool = False


class Session:
    """A run and its report.

    Parameters
    ----------
    study
        The study as run.
    folder
        Of the run; closed in the end. What it has on record already is not run again.
    options
        How to run it.
    interruption
        Ends the run on a signal.
    """

    def __init__(
        self, study: Study, folder: RunFolder, options: RunOptions, interruption: Interruption
    ) -> None:
        self._study = study
        self._folder = folder
        self._options = options
        self._method = METHODS[options.algorithm]
        self._interruption = interruption
        self._monitor = Monitor(study, self._method, options.output, interruption)
        self._display = self._monitor.display

    def run(self) -> int:
        """Tune, validate and report; returns the exit code.

        Raises
        ------
        OutputError, BackendError, StudyError, JournalError
            If the folder, the nodes or the objects cannot be had in the first place.
        """
        code = self._run_on_record()
        self._display.end(code)
        return code

    def _run_on_record(self) -> int:
        folder, options = self._folder, self._options
        with contextlib.closing(folder):
            earlier, damage = NOTHING, ""
            if folder.journal.exists():
                earlier, damage = salvage(folder.journal)
            who = provenance(self._study, options.backend, options.algorithm)
            if options.stop_early:
                who[STOP_EARLY] = "yes"
            if damage:
                self._display.warn(f"the record was damaged: {damage}")
                who["salvaged"] = damage
            backend = self._recorded(earlier)
            try:
                with Journal(folder.journal, who) as journal:
                    try:
                        code = self._run(backend, journal, earlier)
                    except BaseException:
                        # What ended the run matters more than a table that cannot be written.
                        with contextlib.suppress(JournalError):
                            export_csv(folder.journal, folder.path)
                        raise
                    export_csv(folder.journal, folder.path)
                write_deliverables(folder.path, self._display.tell, self._display.warn)
                return code
            except Interrupted as interrupt:
                self._display.warn(f"interrupted by {interrupt}; {self._how_to_resume()}")
                return EXIT_SIGNAL + interrupt.signum
            except (RunError, JournalError, OutputError) as error:
                self._display.warn(f"error: {error}; {self._how_to_resume()}")
                return EXIT_FAULT

    def _recorded(self, earlier: JournalContent) -> RecordedEvaluations:
        try:
            return RecordedEvaluations(self._make_backend(), self._study, earlier.evaluations)
        except KeyError as error:
            raise RunRecordError(
                f"{self._folder.journal}: has evaluations of another study, with {error}"
            ) from error

    def _run(self, backend: RecordedEvaluations, journal: Journal, earlier: JournalContent) -> int:
        try:
            self._interruption.check()
            backend.open()
            self._folder.link_latest()
            options = self._options
            self._display.start(self._folder.path, options.backend, options.algorithm)
            if earlier.evaluations:
                self._display.tell(
                    f"continues after {len(earlier.trials)} trials and "
                    f"{len(earlier.evaluations)} evaluations on record"
                )
            return self._tune(backend, journal, earlier)
        finally:
            # The nodes come down first, whatever happens to the files.
            self._interruption.ignore()
            backend.close()

    def _make_backend(self) -> Backend:
        return make_backend(
            self._options.backend,
            self._study,
            self._folder.log,
            attach=self._options.attach,
            ros_arguments=self._options.ros_arguments,
            interrupted=self._interruption.check,
        )

    def _tune(self, backend: RecordedEvaluations, journal: Journal, earlier: JournalContent) -> int:
        study = self._study
        recording = self._recording(backend)

        def observe(evaluation: Evaluation, parameters: Mapping[str, Value]) -> None:
            if backend.given is None:
                journal.record_evaluation(evaluation, parameters)
                recording.evaluation(evaluation, parameters)
            self._monitor.evaluation(evaluation, parameters)

        tuning = Tuning(study, backend, self._method, observe=observe, trials=earlier.trials)
        with self._live(backend), self._display, recording:
            self._monitor.begin(TUNING, study.budget.trials)
            if tuning.trials:
                self._monitor.recall(tuning.trials, self._best(tuning))
            for trial in self._trials(tuning):
                journal.record_trial(trial)
                leader = self._best(tuning)
                recording.trial(trial, leader is not None and leader.trial.number == trial.number)
                self._monitor.trial(tuning.trials, leader)
            self._monitor.begin(CHECKING, self._method.most_checked)
            best = recommend(
                study,
                backend,
                tuning.trials,
                self._method.models,
                most_checked=self._method.most_checked,
                observe=observe,
                advance=self._monitor.advance,
            )
            recording.phase_ended()
            if best is None:
                self._display.warn("no feasible parameter set: every trial failed")
                return EXIT_INFEASIBLE
            self._monitor.begin(VALIDATION, study.budget.validation_draws)
            default, tuned = validate(
                study,
                backend,
                [study.search_space().defaults, best.candidate.trial.parameters],
                observe=observe,
                advance=self._monitor.advance,
            )
            recording.phase_ended()
        return self._report(best, default, tuned, recording.summary)

    def _trials(self, tuning: Tuning) -> Iterator[Trial]:
        """Run trials up to the budget, or until the advice to stop if it is to be followed."""
        trials = iter(tuning)
        while not (self._options.stop_early and self._monitor.advice is not None):
            trial = next(trials, None)
            if trial is None:
                return
            yield trial

    def _best(self, tuning: Tuning) -> Candidate | None:
        ranked = rank(self._study, tuning.trials, self._method.models)
        return ranked[0] if ranked else None

    def _live(self, backend: RecordedEvaluations) -> contextlib.AbstractContextManager[object]:
        """Tell of the run in the ROS graph, if there is one."""
        ros = backend.backend
        if not isinstance(ros, RosBackend):
            return contextlib.nullcontext()
        live = LiveNode(
            ros.context, self._study, self._folder.path, self._monitor, self._interruption
        )
        return contextlib.closing(live)

    def _recording(self, backend: RecordedEvaluations) -> RunRecording:
        ros = backend.backend
        listen = ros.listen if isinstance(ros, RosBackend) else None
        return RunRecording(
            self._folder.path, self._study, self._options.record, listen, self._display.warn
        )

    def _report(
        self,
        best: Recommendation,
        default: Validation,
        tuned: Validation,
        recorded: Mapping[str, object],
    ) -> int:
        feasible = best.feasible and tuned.feasible
        candidate = best.candidate
        folder = self._folder
        path = folder.write_parameters(self._study, candidate.trial.parameters)
        advice = self._monitor.advice
        summary = {
            "feasible": feasible,
            "trial": candidate.trial.number,
            "checked_trials": best.checked,
            "predicted_objective": candidate.objective,
            "predicted_feasibility": candidate.feasibility,
            "default": dataclasses.asdict(default) | {"feasible": default.feasible},
            "tuned": dataclasses.asdict(tuned) | {"feasible": tuned.feasible},
            "stop_advice": advice and dataclasses.asdict(advice),
            "stopped_early": self._options.stop_early and advice is not None,
            "recording": recorded,
        }
        folder.write_summary(summary)
        amiss = _amiss(self._study, best, tuned)
        self._display.result(Result(self._study, default, tuned, path, amiss, summary))
        return EXIT_OK if feasible else EXIT_INFEASIBLE

    def _how_to_resume(self) -> str:
        return f"go on by: tune --resume {self._folder.path}"


def _amiss(study: Study, best: Recommendation, tuned: Validation) -> str:
    """Tell what speaks against the parameter set found; empty if nothing does."""
    if best.feasible and tuned.feasible:
        return ""
    text = "the parameter set found looked feasible, but did not hold in the validation"
    if not best.feasible:
        text = (
            "no parameter set is feasible as far as the checks can tell; the file holds the "
            "one nearest to it"
        )
    broken = [study.constraints[check.name] for check in tuned.constraints if not check.holds]
    metrics = [study.metrics[constraint.metric] for constraint in broken]
    if metrics and not any(metric.reproducible for metric in metrics):
        names = ", ".join(metric.name for metric in metrics)
        text += f"; only {names} broke a limit, which other load on this machine can do, too"
    return text
