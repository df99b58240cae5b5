"""A verdict and a certificate as a notebook shows them: a small table."""

from collections.abc import Iterable, Sequence
from html import escape

from bo_tuner.evidence.certificate.certificate import Certificate
from bo_tuner.evidence.certificate.findings import ConstraintVerdict
from bo_tuner.evidence.verdict import Verdict
from bo_tuner.evidence.words.limits import in_words
from bo_tuner.evidence.words.quantities import change
from bo_tuner.evidence.words.reasons import proven, reason
from bo_tuner.evidence.words.verdict import headline
from bo_tuner.text import counted, shown_beside, with_unit


def verdict_html(verdict: Verdict) -> str:
    """Return the headline of a verdict, and its numbers beside those of the default."""
    rows = [
        [
            with_unit(quantity.label, quantity.unit),
            *quantity.values_in_words,
            change(quantity),
            quantity.limit_in_words,
            "" if quantity.limit_verdict is None else in_words(quantity.limit_verdict),
        ]
        for quantity in verdict.quantities
    ]
    return _html(headline(verdict), ["", "default", "tuned", "difference", "limit", "found"], rows)


def certificate_html(certificate: Certificate) -> str:
    """Return what a certificate is of, and what it found of each limit."""
    runs = counted(certificate.tuned.evaluations, "fresh test run")
    title = (
        f"{certificate.verdict}: {certificate.study}, trial {certificate.trial}, {runs}, "
        f"{100.0 * certificate.bound_confidence:.4g} % confidence of each bound"
    )
    rows = [_limit(found) for found in certificate.tuned.constraints]
    return _html(title, ["limit", "of", "farthest", "found", "why"], rows)


def _limit(found: ConstraintVerdict) -> list[str]:
    sign = "≤" if found.side == "upper" else "≥"
    limit = f"{sign} {found.limit:g} {found.unit}".rstrip()
    farthest = shown_beside(found.extreme, found.limit)
    return [limit, found.name, farthest, proven(found), reason(found)]


def _html(headline: str, header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in header)
    body = "".join(
        f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows
    )
    return (
        f"<p><b>{escape(headline)}</b></p>"
        f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    )
