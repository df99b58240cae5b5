"""The pages about the runs in a folder: listed, shown, compared, with their files."""

import csv
import io
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from bo_tuner.errors import BoTunerError
from bo_tuner.evidence.certificate.store import certificate_paths
from bo_tuner.evidence.verdict import Status
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.comparison import comparison, in_a_row
from bo_tuner.report.content import Forecast, Table
from bo_tuner.report.page import OF_LISTS, chapters, fill, list_html, render, trial_html
from bo_tuner.report.sections.what_if import forecast
from bo_tuner.report.to_start import to_start
from bo_tuner.report.trial_page import trial_sections
from bo_tuner.report.two_trials import two_trials
from bo_tuner.storage.run_files import BAGS, bag_name
from bo_tuner.storage.run_folder import JOURNAL, STUDY, SUMMARY
from bo_tuner.text import counted, csv_cell, with_unit
from bo_tuner.trials import Value
from bo_tuner.web.files import files_of, size_in_words
from bo_tuner.web.places import (
    COMPARED,
    HOME,
    RUNS,
    STARTED,
    STOP,
    file_address,
    forecasts_address,
    list_address,
    news_address,
    run_address,
    start_address,
    trials_address,
)
from bo_tuner.web.sections import read_as_it_stands

MOST_RUNS = 50
"""Runs on a page of the list; reading all those of a year would take minutes."""
PATIENCE = 0.5
"""Time [s] after which a list shows the runs that are not read yet without a verdict."""
NOT_READ = "…"
"""What stands there in its place."""
MOST_COMPARED = 8
"""Runs side by side; more columns and lines cannot be told apart."""
COLUMNS = ("state", "verdict", "objective", "study", "how", "trials")
"""What the list has of each run, beside its name."""

Signatures = tuple[tuple[int, int] | None, ...]
"""When the files of a run were changed [ns], and their sizes [byte]; None for one that is missing.
"""


@dataclass(frozen=True)
class Frame:
    """What stands around the content of a page about a run or a trial.

    Attributes
    ----------
    home, where
        Address and words of what it belongs to.
    previous, following
        Address and words of its neighbours; None without one.
    """

    home: str
    where: str
    previous: tuple[str, str] | None
    following: tuple[str, str] | None


@dataclass(frozen=True)
class _Known:
    """A run as read, and what its files were like then."""

    files: Signatures
    row: Mapping[str, str] = field(default_factory=dict)
    status: Status = Status.OPEN
    problem: str = ""


class Runs:
    """Makes the pages about the runs in a folder; one thread at a time may use it."""

    def __init__(self, folder: Path, present: str = "", control: str = "") -> None:
        self._folder = folder
        self._present = present
        self._control = control
        self._known: dict[str, _Known] = {}
        # The runs that were looked at last, the latest at the end.
        self._open: dict[str, tuple[Signatures, Analysis]] = {}

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

    def listing(self, page: int = 0) -> str | None:
        """Return a page of the list of runs, counted from 0; None if there is no such page."""
        content = self._listed(page)
        if content is None:
            return None
        return fill(
            "runs.html",
            [*OF_LISTS, "runs.js"],
            title="Runs",
            folder=self._folder.resolve().name,
            sections=[],
            **content,
        )

    def news(self, page: int = 0) -> str | None:
        """Return what a page of the list has now, without what is around it."""
        content = self._listed(page)
        return None if content is None else list_html(**content)

    def _listed(self, page: int) -> dict[str, object] | None:
        """Return the content of a page of the list; None if there is no such page."""
        names = self.names()
        count = max(1, -(-len(names) // MOST_RUNS))
        if not 0 <= page < count:
            return None
        begin = page * MOST_RUNS
        listed = names[begin : begin + MOST_RUNS]
        rows, problems = [], []
        statuses: dict[str, Status] = {}
        unread, end = 0, time.monotonic() + PATIENCE
        is_first = True
        for name in listed:
            if not self._is_known(name):
                # One run at least, so that a list that is asked for again becomes complete.
                if not is_first and time.monotonic() > end:
                    rows.append([name, *(NOT_READ for _ in COLUMNS)])
                    unread += 1
                    continue
                is_first = False
            run = self._read(name)
            if run.problem:
                problems.append(f"{name}: {run.problem}")
                continue
            rows.append([name, *(run.row[column] for column in COLUMNS)])
            statuses[name] = run.status
        if count > 1:
            problems.append(
                f"Runs {begin + 1} to {begin + len(listed)} of {len(names)}, the latest first; the "
                "filter is for these."
            )
        return {
            "present": self._present,
            "unread": unread,
            "news": news_address(page),
            "table": Table(
                caption=counted(len(names), "run"),
                header=["run", *COLUMNS],
                rows=rows,
                numeric=[1 + COLUMNS.index("trials")],
            ),
            "statuses": statuses,
            "notes": problems,
            "most": MOST_COMPARED,
            "home": HOME,
            "address": run_address,
            "newer": list_address(page - 1) if page > 0 else "",
            "older": list_address(page + 1) if page + 1 < count else "",
        }

    def report(self, name: str) -> str | None:
        """Return the report of a run; None if there is no such run."""
        names = self.names()
        if name not in names:
            return None
        analysis = self._analysis(name)
        place = names.index(name)
        # The list has the latest first.
        earlier = names[place + 1] if place + 1 < len(names) else ""
        later = names[place - 1] if place > 0 else ""
        frame = Frame(
            *(RUNS, "All runs"),
            (self._address(earlier), f"earlier run: {earlier}") if earlier else None,
            (self._address(later), f"later run: {later}") if later else None,
        )
        return render(
            analysis,
            chapters(analysis),
            None,
            template="run.html",
            scripts=["start.js"] if self._control else [],
            control=self._control,
            start=start_address(name),
            started=STARTED,
            stop=STOP,
            frame=frame,
            files=self._files(name),
            trials=trials_address(name),
            forecasts=forecasts_address(name),
        )

    def trial(self, name: str, number: int) -> str | None:
        """Return the page of a trial; None if there is none."""
        if name not in self.names():
            return None
        analysis = self._analysis(name)
        if not 0 <= number < len(analysis.trials):
            return None
        trial = analysis.trials[number]

        def beside(other: int) -> tuple[str, str] | None:
            if not 0 <= other < len(analysis.trials):
                return None
            return f"{trials_address(name)}{other}", f"trial {other}"

        frame = Frame(self._address(name), name, beside(number - 1), beside(number + 1))
        bags = {f"{BAGS}/{bag_name(evaluation)}/" for evaluation in trial.evaluations}
        return trial_html(
            analysis,
            trial,
            trial_sections(analysis, trial),
            "run_trial.html",
            frame=frame,
            compare=trials_address(name) + COMPARED,
            latest=len(analysis.trials) - 1,
            files=self._files(name, *bags) if bags else [],
        )

    def two_trials(self, name: str, numbers: Sequence[int]) -> str | None:
        """Return the page that compares two trials of a run; None if one does not exist."""
        if name not in self.names():
            return None
        analysis = self._analysis(name)
        if not all(number < len(analysis.trials) for number in numbers):
            return None
        one, other = (analysis.trials[number] for number in numbers)
        return fill(
            "comparison.html",
            sections=two_trials(analysis, one, other),
            title=f"{analysis.study.name}: trials {one.number} and {other.number}",
            home=self._address(name),
            of=f"trials of {name}",
        )

    def forecast(self, name: str, values: Mapping[str, float]) -> Forecast | None:
        """Return what is predicted for values of a run's parameters; None if it has none such."""
        return None if name not in self.names() else forecast(self._analysis(name), values)

    def to_start(self, name: str, command: str) -> list[str] | None:
        """Return the words of a command that the page of a run has to start; None if it has not."""
        return to_start(self._analysis(name), command) if name in self.names() else None

    def compared(self, names: Sequence[str]) -> str | None:
        """Return the page that compares runs; None if one does not exist."""
        if not set(names) <= set(self.names()):
            return None
        parts = comparison({name: self._analysis(name) for name in names})
        title = f"{len(names)} runs side by side"
        return fill("comparison.html", sections=parts, title=title, home=RUNS, of="tuning runs")

    def table(self) -> str:
        """Return all runs that can be read, a row each, as CSV: verdicts and values."""
        rows: list[dict[str, object]] = []
        for name in self.names():
            known = self._read(name)
            if known.problem:
                continue
            rows.append({"run": name, **known.row, **_values(self._analysis(name))})
        columns = dict.fromkeys(column for row in rows for column in row)
        text = io.StringIO()
        writer = csv.DictWriter(text, list(columns), restval="")
        writer.writeheader()
        writer.writerows({name: csv_cell(cell) for name, cell in row.items()} for row in rows)
        return text.getvalue()

    def file(self, name: str, path: str) -> Path | None:
        """Return a file of a run by its path in the run folder; None if there is none to give."""
        if name not in self.names() or path not in dict(files_of(self._folder / name, path)):
            return None
        return self._folder / name / path

    def _files(self, name: str, *beginnings: str) -> list[tuple[str, str, str]]:
        """Return address, path and size in words of the files of a run."""
        return [
            (file_address(name, path), path, size_in_words(size))
            for path, size in files_of(self._folder / name, *beginnings)
        ]

    def _address(self, name: str) -> str:
        """Return the address of the page of a run."""
        return HOME if name == self._present else run_address(name)

    def _analysis(self, name: str) -> Analysis:
        """Read a run, unless it is as it was when it was looked at of late."""
        files = self._signatures(name)
        known = self._open.pop(name, None)
        if known is None or known[0] != files:
            record = read_as_it_stands(self._folder / name, ended=name != self._present)
            known = files, Analysis(record)
        self._open[name] = known
        if len(self._open) > MOST_COMPARED:
            self._open.pop(next(iter(self._open)))
        return known[1]

    def _is_known(self, name: str) -> bool:
        """Return whether nothing of a run has changed since it was read for the list."""
        return name in self._known and self._known[name].files == self._signatures(name)

    def _read(self, name: str) -> _Known:
        """Return what the list says of a run."""
        if not self._is_known(name):
            files = self._signatures(name)
            try:
                analysis = self._analysis(name)
                self._known[name] = _Known(files, in_a_row(analysis), analysis.verdict.status)
            except BoTunerError as error:
                self._known[name] = _Known(files, problem=str(error))
        return self._known[name]

    def _signatures(self, name: str) -> Signatures:
        folder = self._folder / name
        of_run = [*_of_journal(folder), folder / STUDY, folder / SUMMARY]
        return tuple(_signature(path) for path in (*of_run, *certificate_paths(folder)))


def _values(analysis: Analysis) -> dict[str, Value]:
    """Return the parameters of a run's result, and the numbers of its verdict, by columns."""
    record = analysis.record
    # Before there is one, models find it, which take a second a run.
    answer = analysis.answer if record.summary is None else record.result
    found: dict[str, Value] = {}
    if answer is not None:
        for name, item in analysis.study.parameters.items():
            found[with_unit(name, item.unit)] = answer.parameters[name]
    for quantity in analysis.verdict.quantities:
        column = with_unit(quantity.label, quantity.unit)
        found[column], found[f"default: {column}"] = quantity.tuned, quantity.default
    return found


def _of_journal(folder: Path) -> list[Path]:
    """Return the journal, and the file beside it with what SQLite adds while a run goes on."""
    return [folder / JOURNAL, folder / f"{JOURNAL}-wal"]


def _signature(path: Path) -> tuple[int, int] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size
