"""What speaks for a result, and what to be careful of, in a few lines of the first screen."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from bo_tuner.evidence.busy import MODELLED, times_by
from bo_tuner.evidence.certificate.certificate import Certificate
from bo_tuner.evidence.certificate.parameter_sensitivity import (
    ParameterSensitivity,
    parameter_sensitivity,
)
from bo_tuner.evidence.facts import Basis
from bo_tuner.evidence.quantity import Quantity
from bo_tuner.evidence.verdict import State
from bo_tuner.evidence.words.facts import in_words
from bo_tuner.evidence.words.verdict import reasons
from bo_tuner.report.analysis import Analysis
from bo_tuner.study.titles import titled_values
from bo_tuner.text import capitalized, counted, listed, values

CLOSE = 0.1
"""Share of a limit that a value is within it, below which the margin is worth a word."""


@dataclass(frozen=True)
class Trust:
    """A line: what speaks for the result, or a caution."""

    text: str
    caution: bool = False


def trust_lines(analysis: Analysis) -> tuple[Trust, ...]:
    """Return the lines on a result; none before there is one."""
    if analysis.verdict.state is State.OPEN or analysis.verdict.trial is None:
        return ()
    cautions = (Trust(text, caution=True) for text in _cautions(analysis))
    return tuple(
        replace(line, text=capitalized(line.text)) for line in (*_evidence(analysis), *cautions)
    )


def _evidence(analysis: Analysis) -> Iterator[Trust]:
    verdict, certificate = analysis.verdict, _certificate(analysis)
    if certificate is not None:
        runs = counted(certificate.tuned.evaluations, "fresh test run")
        confidence = f"{100.0 * certificate.bound_confidence:.4g} % confidence"
        yield Trust(f"{runs}, attempt {certificate.attempt}, {confidence} of each bound")
        worst = next((c.worst[0] for c in certificate.tuned.constraints if c.worst), None)
        if worst is not None and worst.context:
            yield Trust(f"Worst context searched: {values(worst.context)}")
        return
    if isinstance(verdict.basis, Basis):
        yield Trust(f"{in_words(verdict.basis)} of default and tuned set".removeprefix("the same "))
    if verdict.state in (State.INFEASIBLE, State.UNPROVEN):
        for reason in reasons(verdict):
            yield Trust(reason, caution=True)
    elif verdict.feasible:
        yield Trust("Not certified: validate proves or refutes it", caution=True)


def _certificate(analysis: Analysis) -> Certificate | None:
    """Return the certificate of the result; None without one."""
    certificate, result = analysis.certificate, analysis.answer
    if certificate is None or result is None or not certificate.is_of(result):
        return None
    return certificate


def _cautions(analysis: Analysis) -> Iterator[str]:
    verdict, study, result = analysis.verdict, analysis.study, analysis.answer
    if (other := analysis.certificate) is not None and _certificate(analysis) is None:
        yield f"The certificate is {other.verdict} of trial {other.trial}, which is not the result"
    if analysis.certificate_problem:
        yield "The certificate is not readable: run validate again"
    if verdict.high_load is not None:
        yield "The computer was busy in some test runs"
    for quantity in verdict.quantities:
        if quantity.limit_verdict is not None and 0.0 <= (margin := _margin(quantity)) < CLOSE:
            yield f"{quantity.limit_verdict.title}: {100.0 * margin:.2g} % from its limit"
    modelled = times_by(study, analysis.record.evaluations, MODELLED)
    if modelled:
        titles = listed([study.metrics[name].title for name in modelled])
        yield f"{titles} modelled, not measured: certify on the machine"
    if result is not None and not analysis.quick and verdict.feasible:
        yield from _narrow(analysis, _steps(analysis))
    yield from (f"{each.title} is at its {each.side} bound" for each in verdict.at_bounds)


def _margin(quantity: Quantity) -> float:
    """Return how far a value is within its limit, relative to the limit; NaN if unknown."""
    found = quantity.limit_verdict
    if found is None or quantity.limit == 0.0:
        return float("nan")
    return found.constraint.sign * (quantity.limit - quantity.tuned) / abs(quantity.limit)


def _steps(analysis: Analysis) -> ParameterSensitivity | None:
    certificate, result = _certificate(analysis), analysis.answer
    if certificate is not None:
        return certificate.parameter_sensitivity
    if result is None:
        return None
    return parameter_sensitivity(analysis.study, result.parameters, analysis.models)


def _narrow(analysis: Analysis, around: ParameterSensitivity | None) -> Iterator[str]:
    over = [] if around is None else [step for step in around.narrow if step.excess > 0.0]
    if over:
        step = titled_values(analysis.study.parameters, over[0].changed)
        yield f"Beyond a limit by the models one step away: {step}"
