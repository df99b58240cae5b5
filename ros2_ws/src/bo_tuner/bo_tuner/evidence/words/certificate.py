"""What is said of a certificate beside its verdict: on what it rests, and what to beware of."""

from collections.abc import Iterable, Iterator
from math import isnan

from bo_tuner.evidence.certificate.certificate import Certificate
from bo_tuner.evidence.certificate.claim import objections
from bo_tuner.evidence.certificate.deaths import Deaths
from bo_tuner.evidence.certificate.findings import Findings
from bo_tuner.evidence.certificate.parameter_sensitivity import Neighbour, ParameterSensitivity
from bo_tuner.evidence.certificate.search_width import SearchWidth
from bo_tuner.evidence.certificate.winners_curse import Gap
from bo_tuner.evidence.words.facts import in_words
from bo_tuner.evidence.words.reasons import assumption
from bo_tuner.models.narrowness import TOLERABLE
from bo_tuner.study.study import Study
from bo_tuner.study.titles import titled_values
from bo_tuner.text import counted, percent, shown


def reasons(study: Study, findings: Findings) -> tuple[str, ...]:
    """Return why a parameter set does not pass; empty if it does."""
    return tuple(map(in_words, objections(study, findings)))


def assumptions(study: Study, findings: Findings) -> tuple[str, ...]:
    """Return on what findings rest besides the numbers of runs that are counted, a line each."""
    return tuple(
        f"{study.limit_title(study.constraints[limit.name])}: with an assumption: "
        f"{assumption(limit.assumption)}"
        for limit in findings.constraints
        if limit.assumption is not None
    )


def price(findings: Findings) -> str:
    """Return the number of runs beside the least."""
    runs = counted(findings.evaluations, "test run")
    if not findings.least:
        return runs
    times = shown(round(findings.evaluations / findings.least, 1))
    return f"{runs}, {times} times the fewest that can show these limits ({findings.least})"


def warnings(study: Study, certificate: Certificate) -> Iterator[str]:
    """Yield what to know that does not affect the verdict, as clauses or sentences."""
    if certificate.deaths is not None:
        yield from of_deaths(certificate.deaths, certificate.bound_confidence)
    around = certificate.parameter_sensitivity
    if around is not None and around.narrow:
        yield of_narrow(study, around)
    if certificate.high_load is not None:
        yield in_words(certificate.high_load)
    for name, value in certificate.held.items():
        wanted = certificate.parameters[name]
        title = study.parameters[name].title
        yield f"{title}: the device holds {value}, in 32 bits, of the {wanted} that it is told"
    for fact in (*certificate.drifts, *certificate.two_kinds, *certificate.uneven):
        yield in_words(fact)


def of_deaths(deaths: Deaths, confidence: float) -> Iterator[str]:
    """Yield what to know of deaths beside a verdict on the runs that ended."""
    yield (
        f"a node died in {deaths.deaths} of {deaths.runs} runs, which were made again; the "
        f"probability of that is at most {percent(deaths.bound)} with "
        f"{100.0 * confidence:.4g} % confidence"
    )
    if deaths.depend_on:
        yield (
            f"deaths depend on {' and '.join(deaths.depend_on)}: what holds of the runs that ended "
            "need not hold of all; leave out death: ignore"
        )


def of_widths(widths: Iterable[SearchWidth]) -> str:
    """Say what the search would have found; empty if there is nothing to say."""
    chances = [
        (w.width, f"with a probability of {100.0 * w.probability:.0f} %")
        for w in widths
        if w.width <= 1
    ]
    if not chances:
        return ""
    (width, probability), *others = chances
    rest = "".join(f", one of {other:.2g} {probably}" for other, probably in others)
    return (
        f"a violation of at least {width:.2g} of the box's edges in width would have been found "
        f"{probability}{rest}"
    )


def of_narrow(study: Study, around: ParameterSensitivity) -> str:
    """Return one line on a narrow optimum."""
    steps = "; ".join(
        titled_values(study.parameters, n.changed)
        + f" (objective {of_step(study, around.optimum, n)}"
        + (f", {100.0 * n.excess:.0f} % over a limit)" if n.excess > 0.0 else ")")
        for n in around.narrow
    )
    return (
        f"narrow optimum: {len(around.narrow)} of {len(around.neighbours)} steps to a neighbour "
        f"break a limit, or cost more than {100.0 * TOLERABLE:.0f} %: {steps}"
    )


def of_step(study: Study, optimum: Neighbour, neighbour: Neighbour) -> str:
    """Return how much the objective changes by a step.

    In percent, or in its unit if the optimum is not positive, for a percentage of it would say
    nothing. Of several objectives, the cost of the compromise in percent of its spread.
    """
    if len(study.objectives) > 1:
        return f"{100.0 * neighbour.loss:+.1f} %"
    if optimum.objective > 0.0:
        return f"{100.0 * (neighbour.objective / optimum.objective - 1.0):+.1f} %"
    unit = study.metrics[study.objective.metric].unit
    return f"{neighbour.objective - optimum.objective:+.3g} {unit}".rstrip()


def of_gap(gap: Gap) -> str:
    """Return how far training and validation are apart, with the standard error."""
    if isnan(gap.value):
        return "–"
    error = gap.standard_error
    return f"{gap.value:+.2g}" + ("" if isnan(error) else f" ± {error:.1g}")
