"""Verdict and certificate as Python programs get them: with the words that are said of them."""

from dataclasses import dataclass, fields

from bo_tuner.evidence import verdict as found
from bo_tuner.evidence.certificate import certificate as made
from bo_tuner.evidence.words.certificate import reasons
from bo_tuner.evidence.words.notebook import certificate_html, verdict_html
from bo_tuner.evidence.words.verdict import headline, sentences
from bo_tuner.study.study import Study


class Verdict(found.Verdict):
    """What was found about the result of a run; a notebook shows it as a table."""

    @property
    def headline(self) -> str:
        """The verdict in one line."""
        return headline(self)

    @property
    def sentences(self) -> tuple[str, ...]:
        """The explanation: evidence, reasons, the default, and what changed beyond chance."""
        return sentences(self)

    def _repr_html_(self) -> str:
        return verdict_html(self)


@dataclass(frozen=True, kw_only=True)
class Certificate(made.Certificate):
    """A certificate; a notebook shows it as a table.

    Attributes
    ----------
    reasons
        Why the parameter set does not pass; empty if it does.
    """

    reasons: tuple[str, ...]

    def _repr_html_(self) -> str:
        return certificate_html(self)


def verdict_in_words(verdict: found.Verdict) -> Verdict:
    """Return a verdict with what is said of it."""
    return Verdict(**{item.name: getattr(verdict, item.name) for item in fields(verdict)})


def certificate_in_words(study: Study, certificate: made.Certificate) -> Certificate:
    """Return a certificate with what is said of it."""
    values = {item.name: getattr(certificate, item.name) for item in fields(certificate)}
    return Certificate(**values, reasons=reasons(study, certificate.tuned))
