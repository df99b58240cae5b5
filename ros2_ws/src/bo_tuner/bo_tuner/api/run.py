"""A run that is open: its folder, its journal, and what it has on record."""

import contextlib
import os
import shutil
import tempfile
import warnings
import weakref
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from bo_tuner.api.earlier import EarlierRun, first_trials
from bo_tuner.backends.recorded import OnRecord
from bo_tuner.errors import OutputError, RunError, RunRecordError
from bo_tuner.evidence.run_verdict import run_verdict
from bo_tuner.evidence.words.verdict import as_summary, notes_of_file
from bo_tuner.methods.registry import METHODS
from bo_tuner.methods.stopping import StopAdvisor
from bo_tuner.report.deliverables import withdraw_result
from bo_tuner.storage.csv_tables import export_csv
from bo_tuner.storage.journal import Journal
from bo_tuner.storage.journal_reader import JournalContent
from bo_tuner.storage.journal_repair import salvage, withdraw_lost
from bo_tuner.storage.provenance import CARRIED, CARRIED_FROM, session_provenance
from bo_tuner.storage.record import read_run
from bo_tuner.storage.run_folder import JOURNAL, LOCK, STUDY, SUMMARY, RunFolder
from bo_tuner.storage.session_options import SessionOptions
from bo_tuner.study.function_study import FUNCTION
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial
from bo_tuner.tuning.journaling import JournalObserver
from bo_tuner.tuning.loop import trials_are_over
from bo_tuner.tuning.observer import NOBODY, Observers, RunObserver
from bo_tuner.tuning.summary import Conclusion, continued, summarize

NOTHING = JournalContent((), (), (), "")


class TemporaryFolder:
    """A folder that is there for as long as this object is; `path` is its path."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="bo_tuner-"))
        weakref.finalize(self, _remove, self.path, os.getpid())


class OpenRun:
    """The run of a function in its folder, which this process alone works in until it is closed.

    Parameters
    ----------
    study, path, algorithm, window
        Of the run. The folder is made if need be.
    temporary
        Keeps a temporary folder; None for a folder of the user's.
    display
        Shows the run.
    earlier
        Runs that it begins with; those of one that is continued are on record.

    Attributes
    ----------
    known
        Trials on record.
    events
        What has come from outside, as it is on record.
    on_record
        Evaluations on record that are not of these.
    observers
        Are notified of each step.

    Raises
    ------
    OutputError, JournalError, RunRecordError
        If the folder or its journal cannot be had.
    """

    def __init__(
        self,
        study: Study,
        path: Path,
        algorithm: str,
        window: int,
        temporary: object = None,
        display: RunObserver = NOBODY,
        earlier: Iterable[EarlierRun] = (),
    ) -> None:
        self.study = study
        self.path = path.absolute()
        self.method = METHODS[algorithm]
        self.window = window
        self.temporary = temporary
        self.closed = False
        self._display = display
        self._advisor = StopAdvisor(study, self.method)
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{path}: cannot write there: {error.strerror}") from error
        with contextlib.ExitStack() as stack:
            folder = stack.enter_context(contextlib.closing(RunFolder(self.path)))
            known, damage, carried = NOTHING, "", None
            if folder.journal.exists():
                known, damage = salvage(folder.journal)
                known = withdraw_lost(folder.journal, known)
            elif (carried := first_trials(study, self.method, earlier)) is not None:
                known = carried.content
            self.events = known.events
            self.on_record = OnRecord(study, known.to_give_again)
            self.known = continued(
                study, self.method, known.trials, known.evaluations, stop_early=False
            )
            options = SessionOptions(window=window)
            provenance = session_provenance(study, FUNCTION, algorithm) | options.provenance
            if damage:
                warnings.warn(f"the record was damaged: {damage}", RuntimeWarning, stacklevel=5)
                provenance["salvaged"] = damage
            if carried is not None:
                provenance |= {CARRIED_FROM: carried.run, CARRIED: carried.text}
            if not folder.journal.exists():
                # A journal without its study is no run.
                folder.write_study(study)
            self._journal = stack.enter_context(Journal(folder.journal, provenance, known.trials))
            # A file of fewer trials is that of an earlier session.
            folder.write_study(study)
            if not trials_are_over(study, known.trials, None):
                withdraw_result(self.path)
            # What is on record first.
            self.observers = Observers()
            self.observers.add(JournalObserver(self._journal, folder.check))
            self.observers.add(display)
            self._folder = folder
            self._open = stack.pop_all()

    @staticmethod
    def begun(path: Path) -> bool:
        """Return whether there is a run in a folder.

        Raises
        ------
        RunRecordError
            If there is something else.
        """
        if (path / JOURNAL).exists():
            return True
        try:
            others = {item.name for item in path.iterdir()} - {LOCK, STUDY}
        except FileNotFoundError:
            return False
        except OSError as error:
            raise RunRecordError(f"{path}: cannot be read: {error.strerror}") from error
        if others:
            raise RunRecordError(f"{path}: is no run folder; name one, or a new folder")
        return False

    def note_trial(self, trials: Sequence[Trial], *, recorded: bool) -> None:
        """Record the last of the trials, unless that is done, and look for advice to stop."""
        self._advisor.consider([trial.unchecked for trial in trials])
        if recorded:
            self.observers.recall(trials[-1:], None)
            return
        shown = self._display is not NOBODY
        best = self.method.incumbent(self.study, trials) if shown else None
        self.observers.trial(trials[-1], best)

    def finish(self, conclusion: Conclusion | None) -> None:
        """Write what the run has led to, and close it."""
        record = read_run(self.path)
        if conclusion is not None:
            summary = summarize(
                self.study,
                conclusion,
                self._advisor.advice,
                stop_early=False,
                finish=None,
                trials=len(record.trials),
                evaluations=self._journal.count_evaluations(),
            )
            verdict = run_verdict(replace(record, summary=summary))
            parameters = conclusion.recommendation.candidate.trial.parameters
            notes = notes_of_file(verdict, self.study)
            self._folder.write_parameters(self.study, parameters, notes)
            self._folder.write_json(SUMMARY, summary | as_summary(verdict))
        export_csv(self._folder.journal, self.path, self.study.search_space().active)
        self.close()

    def check(self) -> None:
        """Refuse to go on where the run is not open.

        Raises
        ------
        RunError
            If it was closed.
        OutputError
            If this process was forked from the one that has opened it.
        """
        if self.closed:
            raise RunError(f"the tuner is closed; open it again on its folder, {self.path}")
        self._folder.check_process()

    def close(self) -> None:
        """Let others work in the folder; does nothing in a process that was forked."""
        if not self._folder.forked:
            self.closed = True
            self._open.close()


def _remove(folder: Path, process: int) -> None:
    if os.getpid() == process:
        shutil.rmtree(folder, ignore_errors=True)
