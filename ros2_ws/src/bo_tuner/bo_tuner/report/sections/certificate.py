"""The certificate of a run, as `validate` has written it."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

from bo_tuner.errors import RunRecordError
from bo_tuner.evidence.certificate.context_tolerance import ContextTolerance
from bo_tuner.evidence.certificate.earlier import earlier_in_words
from bo_tuner.evidence.certificate.store import (
    certificate_paths,
    is_of,
    latest_certificate,
    read_certificate,
    seen_of,
)
from bo_tuner.evidence.certificate.table import (
    certificate_rows,
    gap_in_words,
    parameter_sets,
    search_in_words,
)
from bo_tuner.evidence.verdict import PASS
from bo_tuner.report.content import Section, Table, number
from bo_tuner.storage.record import RunRecord
from bo_tuner.study.measured import seen_in_words
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial


@dataclass(frozen=True)
class CertificateFile:
    """A certificate that was read from its file.

    Attributes
    ----------
    content
        Content of the file.
    section
        Its section in the report.
    """

    content: Mapping[str, Any]
    section: Section

    @property
    def passed(self) -> bool:
        """Whether the parameter set passed."""
        return bool(self.content["verdict"] == PASS)

    @property
    def trial(self) -> int:
        """Number of the trial whose parameter set was tested."""
        return int(self.content["trial"])

    @property
    def scope(self) -> str:
        """Number of draws and confidence."""
        confidence = 100.0 * float(self.content["bound_confidence"])
        return f"{self.content['drawn']} fresh draws, {confidence:.4g} % confidence of each bound"

    @property
    def tolerances(self) -> tuple[ContextTolerance, ...]:
        """How far each context variable may drift."""
        return tuple(map(ContextTolerance.from_mapping, self.content["context_tolerances"]))

    def is_of(self, trial: Trial) -> bool:
        """Return whether the parameter set that was tested is that of a trial."""
        return is_of(self.content, trial)


def certificate(record: RunRecord, answer: Trial | None) -> CertificateFile | None:
    """Read the latest certificate of a run's answer, or else of another trial; None without any.

    Raises
    ------
    RunRecordError
        If it cannot be read, or does not have the format of `validate`.
    """
    paths = certificate_paths(record.path)
    if not paths:
        return None
    path = None if answer is None else latest_certificate(record, answer)
    path = path or next(filter(_is_readable, paths), paths[0])
    content = read_certificate(path)
    try:
        section = _section(record.study, content, path.relative_to(record.path))
        file = CertificateFile(content, section)
        # All that the report takes from it, so that what is wrong is found here.
        _ = (file.passed, file.trial, file.scope)
        for tolerance in file.tolerances:
            _ = record.study.constraints[tolerance.constraint]
            _ = [record.study.contexts[variable.name] for variable in tolerance.variables]
        return file
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError) as error:
        raise RunRecordError(f"{path}: not a readable certificate: {str(error)[:200]!r}") from error


def _is_readable(path: Path) -> bool:
    try:
        return bool(read_certificate(path))
    except RunRecordError:
        return False


def _section(study: Study, content: Mapping[str, Any], path: PurePath) -> Section:
    verdict, searched = str(content["verdict"]), search_in_words(content)
    lead = (
        f"{verdict} for the parameter set of trial {content['trial']}, on {content['drawn']} "
        f"fresh draws. It is attempt {content['attempt']} to certify a parameter set of this run; "
        f"each bound has a confidence of {100.0 * float(content['bound_confidence']):.4g} %."
    )
    return Section(
        name="certificate",
        title=f"Certificate: {verdict}",
        lead=lead,
        tables=[_numbers(study, content), *_gaps(content)],
        notes=[
            *map(str, content["reasons"]),
            *earlier_in_words(content),
            *([f"Search for the worst context: {searched}."] if searched else []),
            *seen_in_words(study.metrics, seen_of(content)),
            *map(str, content["warnings"]),
            f"Details are in {path}, the evaluations in {path.stem}_evaluations.csv beside it.",
        ],
    )


def _numbers(study: Study, content: Mapping[str, Any]) -> Table:
    names = parameter_sets(content)
    return Table(
        caption="Fresh draws of context and noise, and the worst contexts of a search; CVaR is the "
        "mean of the worst draws",
        header=["", *names, "unit"],
        rows=[[row.label, *row.values, row.unit] for row in certificate_rows(study, content)],
        numeric=list(range(1, 1 + len(names))),
    )


def _gaps(content: Mapping[str, Any]) -> list[Table]:
    rows = [
        [
            gap["name"],
            number(gap["observed"]),
            number(gap["predicted"]),
            number(gap["validated"]),
            gap_in_words(gap),
            gap["unit"],
        ]
        for gap in content["training_gaps"]
    ]
    if not rows:
        return []
    return [
        Table(
            caption="Training and validation: a gap of several standard errors means that the "
            "training was over-optimistic (winner's curse)",
            header=["", "observed in training", "predicted", "validated", "gap", "unit"],
            rows=rows,
            numeric=[1, 2, 3, 4],
        )
    ]
