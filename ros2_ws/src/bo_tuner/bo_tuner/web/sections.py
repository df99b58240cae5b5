"""The sections of the page, made anew from the journal whenever the run has come further."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from bo_tuner.report.analysis import Analysis, Known, Preliminary
from bo_tuner.report.content import Section
from bo_tuner.report.page import SECTIONS, answer_html, fill, section_html, trial_html
from bo_tuner.report.sections.appendix import all_trials
from bo_tuner.report.sections.failures import failures
from bo_tuner.report.sections.influence import influence
from bo_tuner.report.trial_page import trial_sections
from bo_tuner.storage.record import RunRecord, read_run
from bo_tuner.tuning.summary import with_summary

Maker = Callable[[Analysis], Section | None]

ANSWER = "answer"
SLOW = (influence,)
"""Sections that take longer than a trial may, and are made at the end only."""
FAST = (failures, all_trials)
"""Sections that are made first, also before a new trial is in the models: it shows at once."""


@dataclass(frozen=True)
class Part:
    """A section as it stands on the page.

    Attributes
    ----------
    name
        Its name.
    place
        Its place from the top.
    html
        Its HTML.
    trials
        Number of trials in the run that it shows.
    """

    name: str
    place: int
    html: str
    trials: int


class LiveSections:
    """Makes the sections of a run in progress.

    Parameters
    ----------
    folder
        The run folder.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._known = Known()
        self._earlier: Analysis | None = None

    def analysis(self, *, ended: bool) -> Analysis:
        """Read the run as it stands now.

        Raises
        ------
        RunRecordError
            If it cannot be read.
        """
        return Analysis(self._record(ended=ended), self._known)

    def _record(self, *, ended: bool) -> RunRecord:
        return read_as_it_stands(self._folder, ended=ended)

    def preliminary(self) -> Iterator[Part]:
        """Yield the first sections of a run that goes on, by the models of `parts` before.

        This may be called while `parts` makes others. Nothing before `parts` had models.
        """
        if (earlier := self._earlier) is not None:
            yield from _made(Preliminary(self._record(ended=False), earlier=earlier), FAST)

    def parts(self, *, ended: bool) -> Iterator[Part]:
        """Yield the sections in the order in which they are ready."""
        analysis = self.analysis(ended=ended)
        later = [make for make in SECTIONS if make not in FAST and (ended or make not in SLOW)]
        yield from _made(analysis, FAST)
        self._earlier = analysis
        yield Part(ANSWER, 0, answer_html(analysis), len(analysis.record.trials))
        yield from _made(analysis, later)

    def shell(self, control: str) -> str:
        """Return the page without sections, which the browser asks for.

        Parameters
        ----------
        control
            The token of requests to the run; without it, the page has no buttons for them.
        """
        study = read_run(self._folder).study
        return fill("live.html", scripts=["live.js"], study=study, sections=[], control=control)

    def trial(self, number: int) -> str | None:
        """Return the page of a trial; None if there is no such trial."""
        analysis = self.analysis(ended=False)
        if not 0 <= number < len(analysis.trials):
            return None
        trial = analysis.trials[number]
        return trial_html(analysis, trial, trial_sections(analysis, trial), home="/")


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


def _made(analysis: Analysis, makers: Iterable[Maker]) -> Iterator[Part]:
    for make in makers:
        if (section := make(analysis)) is not None:
            place, trials = 1 + SECTIONS.index(make), len(analysis.record.trials)
            yield Part(section.name, place, section_html(section), trials)


def _ignore(_: str) -> None:
    pass
