"""The files derived from a run's record: the report and the bundle."""

import contextlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from bo_tuner.deploy.bundle import DEPLOY, withdraw_bundle, write_bundle
from bo_tuner.errors import OutputError, RunRecordError
from bo_tuner.evidence.run_verdict import run_verdict
from bo_tuner.evidence.words.verdict import as_summary
from bo_tuner.report.analysis import Known
from bo_tuner.report.page import write_report
from bo_tuner.storage.record import RunRecord, read_run
from bo_tuner.storage.run_folder import BEST, REPORT, SUMMARY, write_json
from bo_tuner.terminal import from_here
from bo_tuner.tuning.summary import with_summary

Tell = Callable[[str], None]


def write_deliverables(folder: Path, tell: Tell, warn: Tell, known: Known | None = None) -> None:
    """Write or update the report of a run and, if it has a result, its bundle.

    Both can be made again from the record, so a failure is only a warning.
    """
    try:
        record = with_summary(read_run(folder), warn)
        record = with_verdict(record)
        if record.summary is not None:
            # The report lists the folder of the bundle, which is written later: it has a copy of
            # the report. What is wrong with it is reported then.
            with contextlib.suppress(OSError):
                (folder / DEPLOY).mkdir(exist_ok=True)
        tell(f"report: {from_here(write_report(record, folder / REPORT, known))}")
        if record.summary is not None:
            tell(f"bundle: {from_here(write_bundle(record))}")
    except (OutputError, RunRecordError) as error:
        warn(f"warning: {error}; the result is on record")


def withdraw_result(folder: Path) -> None:
    """Remove the files of an earlier session's result, which a run with trials to come has not.

    The certificates stay: what they say of a parameter set holds.
    """
    try:
        for name in (SUMMARY, BEST, REPORT):
            (folder / name).unlink(missing_ok=True)
        withdraw_bundle(folder)
    except OSError as error:
        raise OutputError(f"{error.filename}: cannot be removed: {error.strerror}") from error


def with_verdict(record: RunRecord) -> RunRecord:
    """Bring the verdict in the summary's file up to date with the latest certificate."""
    if record.summary is None:
        return record
    current = as_summary(run_verdict(record))
    if all(record.summary.get(key) == value for key, value in current.items()):
        return record
    summary = {**record.summary, **current}
    write_json(record.path / SUMMARY, summary)
    return replace(record, summary=summary)
