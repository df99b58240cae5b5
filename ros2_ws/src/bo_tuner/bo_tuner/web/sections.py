"""The parts of the page, made anew from the journal whenever the run has come further."""

from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from bo_tuner.report.analysis import Analysis, Known
from bo_tuner.report.page import answer_html, chapter_html, chapters, fill
from bo_tuner.storage.record import RunRecord, read_run
from bo_tuner.text import counted
from bo_tuner.trials import count_trials
from bo_tuner.tuning.summary import with_summary
from bo_tuner.web.places import forecasts_address, trials_address

ANSWER = "answer"


@dataclass(frozen=True)
class Part:
    """A chapter as it stands on the page, or the result.

    Attributes
    ----------
    name, title
        Its name, and its entry in the navigation.
    html
        Its HTML.
    """

    name: str
    title: str
    html: str


@dataclass(frozen=True)
class Made:
    """All parts of the page as of one state of the run, from the top.

    Attributes
    ----------
    parts
        The result, and the chapters behind it.
    stamp
        What state that is, in words.
    """

    parts: tuple[Part, ...]
    stamp: str


class LiveSections:
    """Makes the parts of the page of a run in progress.

    Parameters
    ----------
    folder
        The run folder.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._known = Known()

    def analysis(self, *, ended: bool) -> Analysis:
        """Read the run as it stands now.

        Raises
        ------
        RunRecordError
            If it cannot be read.
        """
        record = read_as_it_stands(self._folder, ended=ended)
        return Analysis(record, self._known, quick=not ended)

    def made(self, *, ended: bool) -> Made:
        """Make all parts as of now; raises `RunRecordError` if the run cannot be read."""
        analysis = self.analysis(ended=ended)
        when = datetime.now().astimezone().strftime("%H:%M:%S")
        count = count_trials(analysis.record.trials)
        stamp = f"As of {counted(count, 'trial')}, {when}"
        parts = [Part(ANSWER, "Result", answer_html(analysis))]
        parts += [
            Part(chapter.name, chapter.title, chapter_html(chapter))
            for chapter in chapters(analysis)
        ]
        return Made(tuple(parts), stamp)

    def shell(self, control: str) -> str:
        """Return the page without sections, which the browser asks for.

        Parameters
        ----------
        control
            The token of requests to the run; without it, the page has no buttons for them.
        """
        study = read_run(self._folder).study
        return fill(
            "live.html",
            scripts=["live.js"],
            served=True,
            study=study,
            sections=[],
            control=control,
            trials=trials_address(self._folder.name),
            forecasts=forecasts_address(self._folder.name),
        )


def read_as_it_stands(folder: Path, *, ended: bool) -> RunRecord:
    """Read a run, with its summary if it may have `ended`.

    Raises
    ------
    RunRecordError
        If it cannot be read.
    """
    record = read_run(folder)
    # The summary of a run that goes on is one of an earlier session.
    return with_summary(record, _ignore) if ended else replace(record, summary=None)


def _ignore(_: str) -> None:
    pass
