"""The runs beside a run: those in the same folder, listed, shown and compared."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from bo_tuner.errors import BoTunerError
from bo_tuner.evidence.certificate.store import certificate_paths
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.comparison import comparison, verdicts_table
from bo_tuner.report.page import chapters, fill, render
from bo_tuner.storage.run_folder import JOURNAL, STUDY, SUMMARY
from bo_tuner.text import counted
from bo_tuner.web.sections import read_as_it_stands

MOST_RUNS = 50
"""Runs in the list; reading all those of a year would take minutes."""
MOST_COMPARED = 8
"""Runs side by side; more columns and lines cannot be told apart."""
HOME = "/"


@dataclass(frozen=True)
class _Known:
    """A run as read, and what its files were like then."""

    files: tuple[tuple[int, int] | None, ...]
    row: Sequence[str] = ()
    problem: str = ""


class Runs:
    """Makes the pages about the runs in a folder; one thread at a time may use it.

    Parameters
    ----------
    folder
        The folder of runs.
    present
        Name of the run in progress.
    """

    def __init__(self, folder: Path, present: str) -> None:
        self._folder = folder
        self._present = present
        self._known: dict[str, _Known] = {}

    def names(self) -> list[str]:
        """Return the names of the run folders, the latest first."""
        runs = []
        with os.scandir(self._folder) as entries:
            for entry in entries:
                journal = Path(entry.path) / JOURNAL
                if entry.is_dir(follow_symlinks=False) and journal.is_file():
                    times = [
                        known[0]
                        for path in _of_journal(journal.parent)
                        if (known := _signature(path)) is not None
                    ]
                    # A run may be deleted meanwhile.
                    if times:
                        runs.append((max(times), entry.name))
        return [name for _, name in sorted(runs, reverse=True)]

    def listing(self) -> str:
        """Return the page that lists the runs."""
        names = self.names()
        known = {name: self._read(name) for name in names[:MOST_RUNS]}
        rows = [run.row for run in known.values() if run.row]
        notes = [f"{name}: {run.problem}" for name, run in known.items() if run.problem]
        if len(names) > MOST_RUNS:
            notes.append(f"The latest {MOST_RUNS} of {len(names)} runs.")
        return fill(
            "runs.html",
            title="Runs",
            folder=self._folder.name,
            present=self._present,
            table=replace(verdicts_table({}, counted(len(rows), "run")), rows=rows),
            notes=notes,
            most=MOST_COMPARED,
            sections=[],
            home=HOME,
        )

    def report(self, name: str) -> str | None:
        """Return the report of a run; None if there is no such run.

        Raises
        ------
        BoTunerError
            If it cannot be read.
        """
        if name not in self.names():
            return None
        analysis = self._analysis(name)
        return render(analysis, chapters(analysis), None)

    def compared(self, names: Sequence[str]) -> str | None:
        """Return the page that compares runs; None if one does not exist.

        Raises
        ------
        BoTunerError
            If one cannot be read.
        """
        if not set(names) <= set(self.names()):
            return None
        parts = comparison({name: self._analysis(name) for name in names})
        title = f"{len(names)} runs side by side"
        return fill("comparison.html", sections=parts, title=title, home="/runs")

    def _analysis(self, name: str) -> Analysis:
        return Analysis(read_as_it_stands(self._folder / name, ended=name != self._present))

    def _read(self, name: str) -> _Known:
        """Read a run, unless nothing of it has changed since the last time."""
        folder = self._folder / name
        of_run = [*_of_journal(folder), folder / STUDY, folder / SUMMARY]
        files = tuple(_signature(path) for path in (*of_run, *certificate_paths(folder)))
        if name not in self._known or self._known[name].files != files:
            try:
                (row,) = verdicts_table({name: self._analysis(name)}, "").rows
                self._known[name] = _Known(files, row)
            except BoTunerError as error:
                self._known[name] = _Known(files, problem=str(error))
        return self._known[name]


def _of_journal(folder: Path) -> list[Path]:
    """Return the journal, and the file beside it with what SQLite adds while a run goes on."""
    return [folder / JOURNAL, folder / f"{JOURNAL}-wal"]


def _signature(path: Path) -> tuple[int, int] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size
