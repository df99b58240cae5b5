"""``validate``: certify the result of a run, or values that somebody else tuned."""

import argparse
import contextlib
import hashlib
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

from rich.console import Console

from bo_tuner import maxima
from bo_tuner.backends.factory import make_backend
from bo_tuner.backends.workers.workers import Workers
from bo_tuner.cli.certifier import Certifier, UndecidedError
from bo_tuner.cli.common import (
    Parser,
    allow_programs,
    attached,
    ended,
    guarded,
    in_namespace_of,
    read_result,
    recorded_backend,
    split_ros_arguments,
    trial_of,
)
from bo_tuner.cli.drift import compare
from bo_tuner.cli.drives import expect, refuse_used_bags
from bo_tuner.cli.exit_codes import EXIT_FAULT, early_end, exit_code
from bo_tuner.cli.given_values import given
from bo_tuner.cli.notify import notify
from bo_tuner.cli.validate_options import check_kind, make_parser
from bo_tuner.cli.workers import workers_of
from bo_tuner.errors import OutputError, RunError, RunRecordError, StudyError
from bo_tuner.evidence.certificate.store import (
    RUNS_KEY,
    draws_of,
    latest_certificate,
    read_certificate,
    shortfall,
)
from bo_tuner.evidence.certificate.unfinished import attempt_for, trial_begun
from bo_tuner.evidence.run_verdict import certified, run_verdict
from bo_tuner.evidence.verdict import PASS, Verdict
from bo_tuner.evidence.words.certificate_table import certificate_lines
from bo_tuner.evidence.words.junit import no_verdict_in_junit, verdict_in_junit
from bo_tuner.evidence.words.next_steps import next_steps
from bo_tuner.evidence.words.verdict import headline, notes_of_file
from bo_tuner.interruption import Interrupted, Interruption
from bo_tuner.monitoring.display import plain_console
from bo_tuner.report.deliverables import write_deliverables
from bo_tuner.storage.atomic import write_atomically, writing
from bo_tuner.storage.parameter_file import from_yaml, node_values
from bo_tuner.storage.record import RunRecord
from bo_tuner.storage.run_files import read_text
from bo_tuner.storage.run_folder import BEST, REPORT, RunFolder
from bo_tuner.study.study import Study
from bo_tuner.terminal import from_here, print_line
from bo_tuner.trials import Trial
from bo_tuner.tuning.recorded_method import recorded_method

MOST_LINES, MOST_STEPS = 8, 2
"""Lines below a verdict, and commands among them."""
XML = b"<?xml"
"""How a file begins that `--junit` may replace."""


def certify(argv: Sequence[str], interruption: Interruption) -> int:
    """Do what the command does, and raise the errors of what has not begun."""
    own, ros_arguments = split_ros_arguments(argv)
    parser = make_parser()
    arguments = parser.parse_args(own)
    check_kind(arguments, parser)
    if arguments.against is not None:
        return compare(arguments, parser, ros_arguments, interruption)
    of_given = given(arguments, parser, ros_arguments, interruption)
    record = read_result(arguments.run) if of_given is None else of_given.record
    # `latest` may name another run by the time that it ends.
    record = replace(record, path=record.path.resolve())
    task = _Task(arguments, parser, record, of_given is not None)
    trial = task.first if of_given is None else of_given.trial
    if arguments.drives:
        return expect(arguments, parser, record, trial, ros_arguments, interruption)
    refuse_used_bags(record.study)
    workers, attach = _bench(task, ros_arguments)
    task.check_draws(trial)
    if of_given is None:
        allow_programs(record, trusted=arguments.trust, attach=attach)
    if arguments.junit is not None:
        _refuse_other_content(arguments.junit)
        # It stays where there is no verdict, in place of an earlier one.
        write_atomically(arguments.junit, no_verdict_in_junit(record.study))
    folder = RunFolder(record.path) if of_given is None else of_given.open_folder()
    # `latest` may be another run by then.
    same = [str(from_here(folder.path)) if item == str(arguments.run) else item for item in argv]
    again = f"continue with: {shlex.join(['validate', *same])}"
    with contextlib.closing(folder):
        certifier = Certifier(
            record,
            folder,
            partial(
                make_backend,
                task.backend,
                record.study,
                folder.log,
                attach=attach,
                ros_arguments=in_namespace_of(record, ros_arguments),
                interrupted=interruption.check,
                earlier=record.evaluations,
                workers=workers,
            ),
            task.confidence,
            interruption,
            task.console,
            with_default=arguments.with_default,
            more=task.most > 1,
            window=workers.window,
            time=arguments.time,
        )
        ending, code = _certify(task, certifier, trial, again)
    notify(arguments.notify, folder.path, code, ending, task.show)
    return code


@dataclass(frozen=True)
class _Task:
    """What is to be certified, and by how much."""

    arguments: argparse.Namespace
    parser: Parser
    record: RunRecord
    of_given: bool

    @cached_property
    def console(self) -> Console:
        return plain_console(stderr=True)

    def show(self, text: str) -> None:
        print_line(self.console, text, "  ")

    @property
    def backend(self) -> str:
        return self.arguments.backend or recorded_backend(self.record)

    @property
    def confidence(self) -> float:
        return self.arguments.confidence or self.record.study.certificate.confidence

    @cached_property
    def most(self) -> int:
        """The largest number of parameter sets to certify."""
        most: int = self.arguments.until_pass
        if not 1 <= most <= maxima.TRIALS:
            bound = "at least 1" if most < 1 else f"at most {maxima.TRIALS}"
            self.parser.error(f"--until-pass: expected {bound}, found {most}")
        return most

    @cached_property
    def first(self) -> Trial:
        """The trial to begin with."""
        trial = _trial(self.record, self.arguments.trial)
        begun = _unfinished(self.record, trial, self.backend) if self.most > 1 else None
        if begun is None:
            return trial
        self.show(f"trial {begun.number} comes first, whose certificate was interrupted")
        return begun

    def draws(self, attempt: int) -> int:
        """Return the largest number of draws, which must be able to show every limit on runs."""
        arguments, sets = self.arguments, 2 if self.arguments.with_default else 1
        study, confidence = self.record.study, self.confidence
        try:
            return draws_of(study, confidence, attempt, arguments.runs, sets=sets)
        except StudyError as error:
            option = "--runs: " if error.path == RUNS_KEY else ""
            self.parser.error(f"{option}{error.problem}" if option else str(error))

    def check_draws(self, trial: Trial) -> None:
        """Refuse too few draws for the last attempt, and warn of those that `apply` refuses."""
        record = self.record
        attempt = attempt_for(record.path, record.study, trial.parameters, self.backend)
        # Each attempt takes more draws than the one before, so the last one needs the most.
        last = attempt + min(self.most, len(record.trials) or 1) - 1
        if missing := shortfall(record.study, self.draws(last), self.confidence):
            purpose = "a PASS is a quick look" if self.of_given else "apply will refuse a PASS"
            self.show(f"warning: {purpose}: {missing}")


def _bench(task: _Task, ros_arguments: Sequence[str]) -> tuple[Workers, bool]:
    """Return by how many workers the runs are made, and whether on nodes that are running."""
    attach = attached(task.arguments, task.parser, task.backend, task.record)
    workers = workers_of(
        task.arguments,
        task.parser,
        task.record.study,
        task.backend,
        attach=attach,
        ros_arguments=in_namespace_of(task.record, ros_arguments),
        known=None if task.of_given else task.record.options,
        keeps_window=False,
    )
    return workers, attach


def _certify(task: _Task, certifier: Certifier, trial: Trial, again: str) -> tuple[str, int]:
    """Certify one parameter set after another until one passes; return the ending and the code."""
    folder, path = certifier.folder, None
    try:
        with writing(folder.log):
            folder.log.mkdir(exist_ok=True)
        for verdict, path, left in _attempts(task, certifier, trial):
            _report(verdict, task.record.study, path)
            if task.arguments.junit is not None:
                content = verdict_in_junit(task.record.study, verdict)
                write_atomically(task.arguments.junit, content)
            if verdict.certificate == PASS or left:
                break
        certifier.interruption.ignore()
        if verdict.certificate == PASS and not verdict.is_result and task.most > 1:
            task.show(_not_the_result(verdict))
    except UndecidedError as undecided:
        ending, code = "the time is over, without a verdict", EXIT_FAULT
        task.show(f"{ending}: {undecided.shown[0]}")
        for line in undecided.shown[1:]:
            task.show(f"  {line}")
        task.show(again)
    except (Interrupted, RunError, OutputError) as error:
        ending, code = early_end(error)
        task.show(f"{ending}; {again}")
    else:
        ending, code = headline(verdict), ended(left, exit_code(verdict))
    finally:
        if path is not None and task.record.result is not None:
            # The verdict on it names the confidence of all certificates of the run.
            write_deliverables(folder.path, lambda _: None, task.show)
            task.show(f"report: {from_here(folder.path / REPORT)}")
    return ending, code


def _attempts(
    task: _Task, certifier: Certifier, trial: Trial
) -> Iterator[tuple[Verdict, Path, list[str]]]:
    """Yield the verdict on each parameter set in turn, its certificate, and what is left."""
    record, folder = task.record, certifier.folder
    digest = _digest(record, trial, folder, task.console) if record.is_result(trial) else None
    for place, candidate in enumerate(_candidates(record, trial, task.most)):
        if place and task.arguments.time.over:
            return
        attempt = attempt_for(folder.path, record.study, candidate.parameters, task.backend)
        _, path, left = certifier.certify(
            candidate, task.draws(attempt), attempt, digest if candidate is trial else None
        )
        yield certified(record, candidate, path), path, left


run = guarded(certify)


def _refuse_other_content(path: Path) -> None:
    """Refuse a file that is no XML: `--junit` must not replace one of the run, by a slip."""
    with writing(path):
        if not path.is_file():
            return
        with path.open("rb") as file:
            beginning = file.read(len(XML))
    if beginning not in (b"", XML):
        raise OutputError(f"{path}: is no XML file; expected one, or the name of a new file")


def _candidates(record: RunRecord, trial: Trial, count: int) -> Iterator[Trial]:
    """Yield a trial, then those next in rank that are believed feasible, without a certificate."""
    yield trial
    if count == 1:
        return
    known = {trial.number} | {
        other.number for other in record.trials if latest_certificate(record, other) is not None
    }
    # A set that failed its check, or failed when it was run again, is no candidate.
    trials = recorded_method(record).checked(record.study, record.trials, record.evaluations)
    ranked = recorded_method(record).ranking.rank(record.study, trials)
    # Trials of one parameter set are one candidate.
    refused = {other.parameter_set for other in record.trials if other.number in known}
    refused |= {c.trial.parameter_set for c in ranked if c.trial.failed_again}
    others: dict[object, int] = {}
    for c in ranked:
        if c.believed_feasible and c.trial.parameter_set not in refused:
            others.setdefault(c.trial.parameter_set, c.trial.number)
    yield from (trial_of(record, number) for number in [*others.values()][: count - 1])


def _trial(record: RunRecord, number: int | None) -> Trial:
    """Return the trial to validate."""
    trial = record.result if number is None else trial_of(record, number)
    if trial is None:
        raise RunRecordError(
            f"{record.path}: has no result: it has not ended, or every trial failed; continue with "
            "tune --resume, or name a --trial"
        )
    return trial


def _unfinished(record: RunRecord, trial: Trial, backend: str) -> Trial | None:
    """Return the trial with an interrupted certificate, if it comes before a further one.

    Trials ahead of it in rank, and `trial` itself, must have theirs.
    """
    if latest_certificate(record, trial) is None:
        return None
    begun = trial_begun(record.path, record.study, record.trials, backend)
    if begun is None or begun.parameter_set == trial.parameter_set:
        return None
    return begun


def _digest(record: RunRecord, trial: Trial, folder: RunFolder, console: Console) -> str:
    """Return the digest of the parameter file, which must hold the trial's values.

    A missing or damaged file is written again, since the journal has these values.
    """
    path = record.path / BEST
    try:
        content = read_text(path)
        values = from_yaml(content)
    except (OSError, ValueError):
        notes = notes_of_file(run_verdict(record), record.study)
        path = folder.write_parameters(record.study, trial.parameters, notes)
        console.print(f"warning: {path}: missing or damaged; made from the journal", soft_wrap=True)
        return hashlib.sha256(path.read_bytes()).hexdigest()
    if values != node_values(record.study, trial.parameters):
        raise RunRecordError(
            f"{path}: does not hold the values of trial {trial.number}, the result of the run"
        )
    return hashlib.sha256(content.encode()).hexdigest()


def _not_the_result(verdict: Verdict) -> str:
    return (
        f"trial {verdict.trial} passed, not the result of the run: report, summary and bundle "
        "remain those of the result"
    )


def _report(verdict: Verdict, study: Study, path: Path) -> None:
    """Print the verdict, and at most `MOST_LINES` below it; the report has the others."""
    out, certificate = plain_console(), read_certificate(path, study)
    print_line(out, headline(verdict), "")
    steps = next_steps(verdict, str(from_here(path.parent.parent)))[:MOST_STEPS]
    # With the path, those of the commands and that of the report.
    for line in certificate_lines(verdict, study, certificate, MOST_LINES - 2 - len(steps)):
        print_line(out, f"  {line}", "    ")
    out.print(f"certificate: {from_here(path)}", soft_wrap=True)
    for step in steps:
        print_line(out, f"next: {step.command}  ({step.purpose})", "    ")
