"""The parts of the page, made anew from the journal whenever the run has come further.

They need no models, so that they are quick however long the run is; those of the result do.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from bo_tuner.report.analysis import Analysis
from bo_tuner.report.page import OF_LISTS, answer_html, fill, live_parts
from bo_tuner.storage.record import RunRecord, read_run
from bo_tuner.text import counted
from bo_tuner.trials import count_trials
from bo_tuner.tuning.summary import with_summary
from bo_tuner.web.places import run_address, trials_address

ANSWER = "answer"


@dataclass(frozen=True)
class Part:
    """A part as it stands on the page: its name, and its HTML."""

    name: str
    html: str


@dataclass(frozen=True)
class Made:
    """All parts of the page as of one state of the run, from the top.

    Attributes
    ----------
    parts
        What the trials say, and at the end the result.
    stamp
        What state that is, in words.
    """

    parts: tuple[Part, ...]
    stamp: str


class LiveSections:
    """Makes the parts of the page of a run in progress."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def made(self, best: Mapping[int, int | None], *, ended: bool) -> Made:
        """Make all parts as of now; raises `RunRecordError` if the run cannot be read."""
        record = read_as_it_stands(self._folder, ended=ended)
        when = datetime.now().astimezone().strftime("%H:%M:%S")
        made = live_parts(record.study, record.trials, best)
        if ended:
            made = {ANSWER: answer_html(Analysis(record)), **made}
        stamp = f"As of {counted(count_trials(record.trials), 'trial')}, {when}"
        return Made(tuple(Part(name, html) for name, html in made.items()), stamp)

    def shell(self, control: str) -> str:
        """Return the page without its parts, which the browser asks for."""
        study = read_run(self._folder).study
        return fill(
            "live.html",
            [*OF_LISTS, "trials.js", "live.js"],
            study=study,
            sections=[],
            control=control,
            trials=trials_address(self._folder.name),
            report=run_address(self._folder.name),
        )


def read_as_it_stands(folder: Path, *, ended: bool) -> RunRecord:
    """Read a run, with its summary if it may have `ended`."""
    record = read_run(folder)
    # The summary of a run that goes on is one of an earlier session.
    return with_summary(record, _ignore) if ended else replace(record, summary=None)


def _ignore(_: str) -> None:
    pass
