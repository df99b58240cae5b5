"""One run of a study, from the open folder to the exit code."""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial

from rclpy.context import Context

from bo_tuner.backends.factory import make_backend
from bo_tuner.backends.recorded import RecordedEvaluations
from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.backends.ros.isolation import namespace_of
from bo_tuner.backends.ros.run_context import run_context
from bo_tuner.backends.ros.tuner_node import LIVE_NODE, full_name
from bo_tuner.backends.workers.pool import WorkerPool
from bo_tuner.backends.workers.workers import Workers
from bo_tuner.cli.common import ended, opened
from bo_tuner.cli.confirm import Confirmation, refused_in
from bo_tuner.cli.exit_codes import early_end, exit_code
from bo_tuner.cli.paused import WAY, ContinueByKey, has_terminal
from bo_tuner.cli.time_limit import TimeLimit
from bo_tuner.cli.time_plan import TimePlan
from bo_tuner.cli.web_options import tell_address
from bo_tuner.errors import JournalError, OutputError, RunError, RunRecordError
from bo_tuner.evidence.run_verdict import run_verdict
from bo_tuner.evidence.verdict import Verdict
from bo_tuner.evidence.words.verdict import as_summary, headline, notes_of_file
from bo_tuner.interruption import Interrupted, Interruption
from bo_tuner.method_names import DEFAULT_METHOD
from bo_tuner.methods.registry import METHODS
from bo_tuner.monitoring.control import RunControl
from bo_tuner.monitoring.display import Output, Result
from bo_tuner.monitoring.monitor import Advisor, make_display
from bo_tuner.monitoring.node import LiveNode
from bo_tuner.monitoring.status import RunStatus
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.plans import Event, EventKind, Phase, finish_in, finished_after
from bo_tuner.recording.abort_bags import AbortBags
from bo_tuner.recording.retention import Policy, RecordOptions
from bo_tuner.recording.run_recording import RunRecording
from bo_tuner.recording.topic_listener import listen_to
from bo_tuner.recording.workers import HeardByWorkers, ListeningBackend
from bo_tuner.report.deliverables import withdraw_result, write_deliverables
from bo_tuner.report.sections.convergence import known_incumbents
from bo_tuner.storage.csv_tables import export_csv
from bo_tuner.storage.guard_record import read_acts
from bo_tuner.storage.journal import Journal
from bo_tuner.storage.journal_reader import JournalContent, read_journal
from bo_tuner.storage.journal_repair import salvage, withdraw_lost
from bo_tuner.storage.provenance import (
    CARRIED,
    CARRIED_FROM,
    SIMULATION_FROM,
    SIMULATION_SHA256,
    SIMULATION_TAKEN,
    changed_sources,
    file_sha256,
    session_provenance,
)
from bo_tuner.storage.record import RunRecord
from bo_tuner.storage.run_folder import RECORDING, SIMULATION, SUMMARY, RunFolder, how_to_resume
from bo_tuner.storage.session_options import SessionOptions
from bo_tuner.study.parts import ROS
from bo_tuner.study.study import Study
from bo_tuner.text import counted
from bo_tuner.trials import Trial
from bo_tuner.tuning.carrying import Carried
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.gate import Gate
from bo_tuner.tuning.journaling import JournalObserver
from bo_tuner.tuning.loop import Tuning, trials_are_over
from bo_tuner.tuning.observer import Observers, RunObserver
from bo_tuner.tuning.parking import ParkInPause
from bo_tuner.tuning.simulated_runs import write_simulation
from bo_tuner.tuning.summary import Conclusion, conclude, continued, summarize
from bo_tuner.web.address import Address
from bo_tuner.web.live_page import LivePage

NOTHING = JournalContent((), (), (), "")


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
    workers
        How many evaluations are run at once, and where.
    time
        By when the result is to be there.
    more
        Whether a run that is resumed goes on with trials although it was asked to finish.
    carried
        What a new run takes of an earlier one; None for nothing.
    simulation
        What it knows of a simulation of the machine; None for nothing.
    web
        Where to serve the live page; None for no page.
    web_control
        Whether the page may pause and end the run.
    confirm
        Whether to ask before each trial.
    certify
        Whether a certificate of the result follows, within `time`.
    """

    algorithm: str = DEFAULT_METHOD
    backend: str = ROS
    attach: bool = False
    ros_arguments: Sequence[str] = ()
    record: RecordOptions = dataclasses.field(default_factory=RecordOptions)
    output: Output = Output.PROGRESS
    stop_early: bool = False
    workers: Workers = dataclasses.field(default_factory=Workers)
    more: bool = False
    time: TimeLimit = dataclasses.field(default_factory=TimeLimit)
    carried: Carried | None = None
    simulation: Carried | None = None
    web: Address | None = None
    web_control: bool = False
    confirm: bool = False
    certify: bool = False


class Session:
    """A run and its report."""

    def __init__(
        self, study: Study, folder: RunFolder, options: RunOptions, interruption: Interruption
    ) -> None:
        self._study = study
        self._folder = folder
        self._options = options
        self._method = METHODS[options.algorithm]
        if options.simulation is not None:
            self._method = self._method.knowing(study, options.simulation.trials)
        self._interruption = interruption
        self._status = RunStatus(study, self._method, workers=options.workers.count)
        self._observers = Observers()
        self._incumbents: dict[int, Candidate | None] = {}
        self._live_page: RunObserver | None = None
        self._ended_by = ""
        self._advisor = Advisor(study, self._method, self._observers)
        self._gate = Gate(
            interruption.check, self._observers, time_is_up=lambda: self._time.has_to_finish
        )
        self._control = RunControl(self._gate, interruption, folder.path)
        going_on = self._control.going_on(self._ways_to_continue)
        self._display = make_display(study, options.output, self._status, going_on)
        self._time = TimePlan(
            study, self._status, options.time, self._display.inform, certify=options.certify
        )
        records_nothing = options.record.policy is Policy.NONE
        self._backend = make_backend(
            options.backend,
            study,
            folder.log,
            attach=options.attach,
            ros_arguments=options.ros_arguments,
            interrupted=interruption.check,
            halt=self._halt,
            workers=options.workers,
            listening=None if records_nothing else partial(ListeningBackend, listen_to),
        )

    def _halt(self, reason: str) -> None:
        """Let the run wait: the guard has taken over, and somebody must see to the machine."""
        self._gate.halt(reason)
        self._display.warn(f"{reason}; the run waits until you have looked at the machine")

    @property
    def headline(self) -> str:
        """What has come of the run, in a line, once it has ended."""
        verdict = self._status.now.verdict
        return self._ended_by or ("" if verdict is None else headline(verdict))

    def warn(self, text: str) -> None:
        """Show a warning."""
        self._display.warn(text)

    def run(self) -> int:
        """Tune, validate and report; returns the exit code."""
        with self._page():
            code = self._run_on_record()
        self._display.finish(code)
        return code

    @contextlib.contextmanager
    def _page(self) -> Iterator[None]:
        """Serve the live page, if it is asked for, until the files of the result are written."""
        address = self._options.web
        if address is None:
            yield
            return
        status, display = self._status, self._display
        control = self._control if self._options.web_control else None
        folder = self._folder.path
        question = self._gate.question
        with LivePage(
            self._study, folder, status, address, display.warn, control, question
        ) as page:
            self._live_page = page
            show = display.warn if self._options.output is Output.QUIET else display.inform
            tell_address(address, "live page", show)
            yield

    def _run_on_record(self) -> int:
        folder = self._folder
        with contextlib.closing(folder):
            earlier, damage = NOTHING, ""
            if folder.journal.exists():
                earlier, damage = salvage(folder.journal)
                earlier = withdraw_lost(folder.journal, earlier)
            elif (carried := self._options.carried) is not None:
                earlier = carried.content
            simulation = self._options.simulation
            if simulation is not None and not folder.journal.exists():
                write_simulation(folder.path, simulation)
            provenance = self._provenance(earlier, damage)
            backend = self._recorded(earlier)
            if isinstance(self._backend, RosBackend):
                self._backend.recall(earlier.evaluations)
            active, begun = self._study.search_space().active, folder.journal.exists()
            try:
                try:
                    with (
                        opened(backend, self._interruption) as left,
                        Journal(folder.journal, provenance, earlier.trials) as journal,
                    ):
                        begun = True
                        # A file of fewer trials is that of an earlier session.
                        folder.write_study(self._study)
                        if self._goes_on(earlier):
                            withdraw_result(folder.path)
                        code = self._run(backend, journal, earlier)
                except BaseException:
                    # What ended the run matters more than a table that cannot be written.
                    with contextlib.suppress(JournalError, OutputError):
                        folder.check()
                        export_csv(folder.journal, folder.path, active)
                    raise
                export_csv(folder.journal, folder.path, active)
                known = known_incumbents(self._incumbents)
                write_deliverables(folder.path, self._display.inform, self._display.warn, known)
                return ended(left, code)
            except (Interrupted, RunError, JournalError, OutputError) as error:
                if not begun:
                    # There is nothing to go on with.
                    raise
                self._ended_by, code = early_end(error)
                self._display.warn(f"{self._ended_by}; {how_to_resume(folder.path)}")
                return code

    def _goes_on(self, earlier: JournalContent) -> bool:
        """Return whether trials are to come, so that the result on record is no longer the run's.

        One that may stop early may have none to come; its files are written again at the end.
        """
        return not trials_are_over(self._study, earlier.trials, self._finished(earlier))

    def _finished(self, earlier: JournalContent) -> int | None:
        """Return after how many trials the run is to finish, unless it is to have more now."""
        return None if self._options.more else finished_after(earlier.events)

    def _provenance(self, earlier: JournalContent, damage: str) -> dict[str, str]:
        """Return what works on the run from now on, and warn of what has changed."""
        options = self._options
        provenance = session_provenance(self._study, options.backend, options.algorithm)
        provenance |= self._kept.provenance
        if options.carried is not None:
            provenance[CARRIED_FROM] = options.carried.run
            provenance[CARRIED] = options.carried.text
        if options.simulation is not None:
            provenance[SIMULATION_FROM] = options.simulation.run
            provenance[SIMULATION_TAKEN] = options.simulation.text
            provenance[SIMULATION_SHA256] = file_sha256(self._folder.path / SIMULATION)
        if damage:
            self._display.warn(f"the record was damaged: {damage}")
            provenance["salvaged"] = damage
        if earlier.sessions:
            changed = changed_sources(earlier.sessions[-1], provenance)
            if changed:
                self._display.warn(
                    f"warning: the code of {', '.join(changed)} has changed since the last session "
                    "of this run; the run continues with it, and the record says so"
                )
        return provenance

    def _recorded(self, earlier: JournalContent) -> RecordedEvaluations:
        try:
            return RecordedEvaluations(self._backend, self._study, earlier.to_give_again)
        except KeyError as error:
            raise RunRecordError(
                f"{self._folder.journal}: has test runs of another study, with {error}"
            ) from error

    def _run(self, backend: RecordedEvaluations, journal: Journal, earlier: JournalContent) -> int:
        self._folder.link_latest()
        options = self._options
        self._display.start(self._folder.path, options.backend, options.algorithm)
        if several := options.workers.text:
            self._display.inform(several)
        if options.carried is not None:
            self._display.inform(f"begins with {options.carried.text}, of {options.carried.run}")
        elif earlier.evaluations:
            self._display.inform(
                f"continues after {counted(len(earlier.trials), 'trial')} and "
                f"{counted(len(earlier.evaluations), 'test run')} on record"
            )
        if options.simulation is not None:
            self._display.inform(
                f"knows {options.simulation.text}, of the simulation {options.simulation.run}"
            )
        if acts := read_acts(self._folder.log):
            self._display.warn(f"on record, {acts[-1]}")
        study, observers = self._study, self._observers
        if options.more and any(
            finished_after(earlier.events, phase) is not None
            for phase in (Phase.TUNING, Phase.CHECKING)
        ):
            journal.record_event(Event(Phase.TUNING, len(earlier.trials), EventKind.EXTEND))
        finished = self._finished(earlier)
        known = continued(
            study,
            self._method,
            earlier.trials,
            earlier.evaluations,
            stop_early=options.stop_early,
            finished=finished,
        )
        driver = Driver(backend, observers, window=options.workers.window, gate=self._gate)
        refused = refused_in(earlier.events)
        tuning = Tuning(
            study, driver, self._method, trials=known, finished=finished, refused=refused
        )
        if options.confirm:
            self._gate.admission = Confirmation(
                study,
                self._method,
                lambda: tuning.trials,
                list(self._ways("/accept or /refuse (std_srvs/srv/Trigger)")),
            )
        with self._watched(journal) as recording:
            observers.begin(Phase.TUNING, study.budget.trials)
            if finished is not None:
                self._status.finish_after(finished)
            if tuning.trials:
                observers.recall(tuning.trials, self._best(tuning))
                # The time that observers took for these trials is none of the next trial's.
                self._status.restart()
            for trial in self._trials(tuning):
                best = self._best(tuning)
                self._incumbents[len(tuning.trials)] = best
                observers.trial(trial, best)
            observers.end(Phase.TUNING)
            settled = None if options.more else finished_after(earlier.events, Phase.CHECKING)
            conclusion = conclude(study, driver, self._method, tuning.trials, settled)
            if options.time.over:
                self._display.warn(
                    f"warning: it took longer than the --time, by {-options.time.left:.0f} s"
                )
            if self._time.outcome:
                self._display.inform(self._time.outcome)
            summary = (
                None
                if conclusion is None
                else self._summary(conclusion, len(tuning.trials), journal)
            )
            verdict = self._verdict(summary)
            self._status.conclude(verdict)
        if recording.summary["policy"] != Policy.NONE:
            self._folder.write_json(RECORDING, recording.summary)
        if conclusion is None or summary is None:
            self._display.no_result(verdict, self._folder.path)
            return exit_code(verdict)
        self._report(conclusion, verdict, summary)
        return exit_code(verdict)

    @contextlib.contextmanager
    def _watched(self, journal: Journal) -> Iterator[RunRecording]:
        """Let all observers see the run: what is durable first, what may wait last."""
        pool, ros = self._backend, self._backend if isinstance(self._backend, RosBackend) else None
        recording = self._recording()
        with contextlib.ExitStack() as stack:
            journaling = JournalObserver(journal, self._folder.check)
            for observer in (journaling, recording, self._status, self._time, self._display):
                self._observers.add(observer)
            if ros is not None:
                ros.after_extra_run = recording.skip
                ros.at_abort = AbortBags(self._folder.path, self._study, self._display.warn)
                self._show_on_ros(ros.context, ros.park, stack)
            elif isinstance(pool, WorkerPool) and pool.name == ROS:
                context = stack.enter_context(
                    run_context(self._options.ros_arguments, self._options.workers.benches)
                )
                self._show_on_ros(context, pool.park, stack)
            if self._live_page is not None:
                self._observers.add(self._live_page)
            self._observers.add(ContinueByKey(partial(self._gate.requests.request, False)))
            self._observers.add(self._advisor)
            stack.enter_context(self._display)
            stack.enter_context(recording)
            yield recording

    def _recording(self) -> RunRecording:
        """Make the recording of what the nodes say, here or at workers."""
        backend, count = self._backend, self._options.workers.count
        about = (self._folder.path, self._study, self._options.record)
        warn = self._display.warn
        if isinstance(backend, RosBackend):
            listen = partial(listen_to, backend)
            return RunRecording(*about, listen, warn, lambda: backend.recording)
        if isinstance(backend, WorkerPool) and backend.name == ROS:
            heard = HeardByWorkers(backend.take_answer)
            return RunRecording(
                *about, heard.to, warn, lambda: heard.signals, lambda: heard.worker, at_once=count
            )
        return RunRecording(*about, None, warn)

    def _show_on_ros(
        self, context: Context, park: Callable[[], list[str]], stack: contextlib.ExitStack
    ) -> None:
        """Let a node publish the run and take requests, and have the machine parked in a pause."""
        live = LiveNode(context, self._study, self._folder.path, self._status, self._control)
        self._observers.add(stack.enter_context(contextlib.closing(live)))
        self._observers.add(ParkInPause(park, self._display.warn))

    def _trials(self, tuning: Tuning) -> Iterator[Trial]:
        """Run trials up to the budget, or until the advice to stop if it is to be followed."""
        if self._stops:
            tuning.plan.finish()
        for trial in tuning:
            yield trial
            if self._stops:
                tuning.plan.finish()

    @property
    def _stops(self) -> bool:
        """Whether the advice to stop is to be followed and was given."""
        return self._options.stop_early and self._advisor.advice is not None

    def _best(self, tuning: Tuning) -> Candidate | None:
        return self._method.incumbent(self._study, tuning.trials)

    def _summary(self, conclusion: Conclusion, trials: int, journal: Journal) -> dict[str, object]:
        return summarize(
            self._study,
            conclusion,
            self._advisor.advice,
            stop_early=self._options.stop_early,
            finish=finish_in(read_journal(self._folder.journal).events),
            trials=trials,
            evaluations=journal.count_evaluations(),
        )

    @property
    def _ways_to_continue(self) -> Iterator[str]:
        """Ways in which a paused run can be continued, in words."""
        if has_terminal():
            yield WAY
        yield from self._ways("/pause (std_srvs/srv/SetBool, data: false)")

    def _ways(self, service: str) -> Iterator[str]:
        """Yield in words the ways to tell the run something, elsewhere than on the terminal."""
        options = self._options
        if options.web is not None and options.web_control:
            yield "on the live page"
        if options.backend == ROS:
            yield f"by the service {full_name(self._namespace, LIVE_NODE)}{service}"

    @property
    def _namespace(self) -> str:
        """Namespace of the nodes; empty without any."""
        options = self._options
        return namespace_of(options.ros_arguments) if options.backend == ROS else ""

    @property
    def _kept(self) -> SessionOptions:
        """The options that the next session goes on with."""
        options = self._options
        return SessionOptions(
            stop_early=options.stop_early,
            attached=options.attach,
            namespace=self._namespace,
            window=options.workers.window,
            workers=options.workers.count,
            scheduler=options.workers.scheduler,
            benches=tuple(bench.name for bench in options.workers.benches),
            record=str(options.record.policy),
            record_limit=options.record.limit,
        )

    def _verdict(self, summary: Mapping[str, object] | None) -> Verdict:
        """Return the verdict on the result: that of its certificate, if it has one."""
        content = read_journal(self._folder.journal)
        return run_verdict(
            RunRecord(
                path=self._folder.path,
                study=self._study,
                algorithm=self._options.algorithm,
                backend=self._options.backend,
                options=self._kept,
                provenance=content.sessions[-1],
                trials=content.trials,
                evaluations=content.evaluations,
                summary=summary,
                damage=content.damage,
                events=content.events,
            )
        )

    def _report(self, conclusion: Conclusion, verdict: Verdict, summary: dict[str, object]) -> None:
        folder = self._folder
        parameters = conclusion.recommendation.candidate.trial.parameters
        notes = notes_of_file(verdict, self._study)
        path = folder.write_parameters(self._study, parameters, notes)
        summary |= as_summary(verdict)
        folder.write_json(SUMMARY, summary)
        self._display.result(Result(self._study, verdict, parameters, path, summary))
