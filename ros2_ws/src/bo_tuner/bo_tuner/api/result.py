"""The result of a run: read from its folder, as it stands there."""

import base64
import html
from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from bo_tuner.api.certificates import certify_trial
from bo_tuner.api.in_words import (
    Certificate,
    Verdict,
    certificate_in_words,
    verdict_in_words,
)
from bo_tuner.backends.function import Function
from bo_tuner.errors import MissingPackageError, RunRecordError
from bo_tuner.evidence.certificate.store import latest_certificate, read_certificate
from bo_tuner.evidence.run_verdict import run_verdict
from bo_tuner.figures.figure import Figure
from bo_tuner.storage.csv_tables import evaluation_row, trial_row
from bo_tuner.storage.record import RunRecord, read_run
from bo_tuner.storage.run_folder import REPORT
from bo_tuner.text import shown
from bo_tuner.trials import Value
from bo_tuner.tuning.summary import with_summary

if TYPE_CHECKING:
    from pandas import DataFrame


class Result:
    """A run as it is on record; made by `load`, `Study.optimize` and `Tuner.result`.

    Parameters
    ----------
    record
        The run, with its summary.
    keep
        Keeps a temporary folder for as long as the result is there.
    """

    def __init__(self, record: RunRecord, keep: object = None) -> None:
        self._record = record
        self._keep = keep

    @property
    def folder(self) -> Path:
        """Folder of the run."""
        return self._record.path

    @property
    def best(self) -> dict[str, Value] | None:
        """Value of every parameter that the result has, by name; None while there is none."""
        trial = self._record.result
        return None if trial is None else self._record.study.as_given(trial.parameters)

    @property
    def verdict(self) -> Verdict:
        """What was found about the result: `headline` and `sentences` say it in words."""
        return verdict_in_words(run_verdict(self._record))

    @property
    def certificate(self) -> Certificate | None:
        """The latest certificate of the result; None without one.

        Raises
        ------
        RunRecordError
            If it cannot be read.
        """
        trial = self._record.result
        path = None if trial is None else latest_certificate(self._record, trial)
        if path is None:
            return None
        study = self._record.study
        return certificate_in_words(study, read_certificate(path, study))

    @cached_property
    def figures(self) -> Mapping[str, "Picture"]:
        """The figures of the report by name; a notebook shows each as it is."""
        from bo_tuner.report.analysis import Analysis
        from bo_tuner.report.page import chapters, report_figures

        analysis = Analysis(self._record)
        figures = report_figures(analysis, chapters(analysis))
        return {item.name: Picture(item) for item in figures}

    def trials(self) -> "DataFrame":
        """Return the trials as a data frame; columns as of ``trials.csv``.

        Raises
        ------
        MissingPackageError
            If pandas is not installed.
        """
        active = self._record.study.search_space().active
        return _frame((trial_row(each, active) for each in self._record.trials), "number")

    def evaluations(self) -> "DataFrame":
        """Return all evaluations as a data frame; columns as of ``evaluations.csv``.

        Raises
        ------
        MissingPackageError
            If pandas is not installed.
        """
        active = self._record.study.search_space().active
        return _frame((evaluation_row(e, active) for e in self._record.evaluations), "trial")

    def certify(
        self,
        function: Function,
        *,
        runs: int | None = None,
        confidence: float | None = None,
        workers: int | None = None,
        timeout: float | None = None,
        progress: bool = True,
    ) -> Certificate:
        """Certify the result by fresh runs of the function; the certificate stays in the folder.

        Parameters and errors are those of `bo_tuner.certify`.

        Raises
        ------
        RunRecordError
            If the run has no result.
        """
        from bo_tuner.report.deliverables import with_verdict

        trial = self._record.result
        if trial is None:
            raise RunRecordError(f"{self.folder}: has no result to certify")
        certificate = certify_trial(
            self._record,
            trial,
            function,
            runs=runs,
            confidence=confidence,
            workers=workers,
            timeout=timeout,
            progress=progress,
        )
        self._record = with_verdict(self._record)
        return certificate

    def report(self) -> Path:
        """Write the report of the run, ``report.html`` in its folder, and return its path.

        Raises
        ------
        OutputError
            If the file cannot be written.
        """
        from bo_tuner.report.page import write_report

        return write_report(self._record, self.folder / REPORT)

    def __repr__(self) -> str:
        return f"<Result: {self.verdict.headline}; best {self.best}>"

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><th>{html.escape(name)}</th><td>{html.escape(shown(value))}</td></tr>"
            for name, value in (self.best or {}).items()
        )
        verdict = self.verdict
        headline = html.escape(verdict.headline)
        sentences = html.escape(" ".join(verdict.sentences))
        return f"<p><b>{headline}</b></p><table>{rows}</table><p>{sentences}</p>"


class Picture:
    """A figure, which a notebook shows as it is.

    Parameters
    ----------
    figure
        What it shows.
    """

    def __init__(self, figure: Figure) -> None:
        self._figure = figure

    @property
    def caption(self) -> str:
        """What it shows, in a sentence or two."""
        return self._figure.caption

    def svg(self) -> bytes:
        """Return it as an SVG file."""
        # Matplotlib takes a second to load.
        from bo_tuner.figures.matplotlib_renderer import render

        return render(self._figure, "svg")

    def _repr_html_(self) -> str:
        # As an image of its own: the names within one SVG would be those of the others, too.
        data = base64.b64encode(self.svg()).decode("ascii")
        caption = html.escape(self.caption)
        return f'<img alt="{caption}" src="data:image/svg+xml;base64,{data}"><p>{caption}</p>'


def load(run: str | Path, *, keep: object = None) -> Result:
    """Read a run, also one of ``tune``, or one that is going on.

    Parameters
    ----------
    run
        Its folder.
    keep
        As of `Result`.

    Raises
    ------
    RunRecordError
        If it is no run folder, or its record cannot be read.
    """
    return Result(with_summary(read_run(Path(run)), lambda _: None), keep)


def _frame(rows: Iterable[Mapping[str, object]], first: str) -> "DataFrame":
    try:
        from pandas import DataFrame
    except ImportError as error:
        raise MissingPackageError(
            "data frames need pandas: pip install 'bo_tuner[pandas]'; without it, the tables are "
            "trials.csv and evaluations.csv in the run folder"
        ) from error
    records = list(rows)
    columns = list(dict.fromkeys(column for row in records for column in row)) or [first]
    return DataFrame(records, columns=columns)
