"""The certificate of a run, as `validate` has written it."""

from pathlib import Path, PurePath

from bo_tuner.errors import RunRecordError
from bo_tuner.evidence.certificate.certificate import Certificate
from bo_tuner.evidence.certificate.claim import failed_before, seen
from bo_tuner.evidence.certificate.store import (
    certificate_paths,
    latest_certificate,
    read_certificate,
)
from bo_tuner.evidence.words.certificate import (
    assumptions,
    of_gap,
    of_widths,
    price,
    reasons,
    warnings,
)
from bo_tuner.evidence.words.certificate_table import certificate_rows
from bo_tuner.evidence.words.facts import in_words
from bo_tuner.report.content import Section, Table, number
from bo_tuner.storage.record import RunRecord
from bo_tuner.study.study import Study
from bo_tuner.text import capitalized
from bo_tuner.trials import Trial


def certificate(record: RunRecord, answer: Trial | None) -> tuple[Certificate, Section] | None:
    """Read the latest certificate of a run's answer, or else of another trial, with its section."""
    paths = certificate_paths(record.path)
    if not paths:
        return None
    path = None if answer is None else latest_certificate(record, answer)
    path = path or next((path for path in paths if _is_readable(path, record.study)), paths[0])
    latest = read_certificate(path, record.study)
    return latest, _section(record.study, latest, path.relative_to(record.path))


def _is_readable(path: Path, study: Study) -> bool:
    try:
        read_certificate(path, study)
    except RunRecordError:
        return False
    return True


def _section(study: Study, certificate: Certificate, path: PurePath) -> Section:
    searched = of_widths(certificate.search_widths)
    lead = (
        f"Trial {certificate.trial}, attempt {certificate.attempt} of this run: "
        f"{price(certificate.tuned)}; {100.0 * certificate.bound_confidence:.4g} % confidence of "
        "each bound."
    )
    return Section(
        name="certificate",
        title=f"Certificate: {certificate.verdict}",
        lead=lead,
        tables=[_numbers(study, certificate), *_gaps(certificate)],
        notes=[
            *reasons(study, certificate.tuned),
            *assumptions(study, certificate.tuned),
            *map(in_words, failed_before(study, certificate)),
            *([f"Search for the worst context: {searched}."] if searched else []),
            *map(in_words, seen(study, certificate.seen)),
            *(f"{capitalized(line)}." for line in certificate.in_force),
            *warnings(study, certificate),
            f"All of it is in {path}.",
        ],
    )


def _numbers(study: Study, certificate: Certificate) -> Table:
    names = [*certificate.sides]
    return Table(
        caption="Fresh test runs, and the worst contexts of a search; CVaR: mean of the worst runs",
        header=["", *names, "unit"],
        rows=[[row.label, *row.values, row.unit] for row in certificate_rows(study, certificate)],
        numeric=list(range(1, 1 + len(names))),
    )


def _gaps(certificate: Certificate) -> list[Table]:
    rows = [
        [
            gap.name,
            number(gap.observed),
            number(gap.predicted),
            number(gap.validated),
            of_gap(gap),
            gap.unit,
        ]
        for gap in certificate.training_gaps
    ]
    if not rows:
        return []
    return [
        Table(
            caption="A gap of several standard errors: the training was over-optimistic",
            header=["", "observed", "predicted", "validated", "gap", "unit"],
            rows=rows,
            numeric=[1, 2, 3, 4],
        )
    ]
