"""How busy the computer was in runs whose measured times are limited.

A node that reports a time says how it has obtained it, in the key `SOURCE` behind the beginning of
the time's own key: ``return_time_source: cpu`` is of ``return_time_p99``, too. One that says
nothing has measured it by the clock, so that waiting for a processor is in it.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from bo_tuner.evidence.facts import Fact
from bo_tuner.processor_load import HIGH
from bo_tuner.study.metrics import COMPUTED, ReportedMetric, StudyMetric
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Outcome

SOURCE = "_source"
COMPUTING, MODELLED = "cpu", "modelled"
"""Sources of a time in which no waiting is: what the node's own thread computed, and a model."""


@dataclass(frozen=True)
class HighLoad(Fact):
    """Runs with limits on measured times in which the load was high.

    Attributes
    ----------
    metrics
        What screens call the times.
    runs, known
        Number of these runs, and of all of which the load is known.
    whose
        Trials that they are of, by number, and sides of the validation, in the order of the runs.
    largest
        Largest share of waiting among them.
    of_nodes
        Whether it is that of the nodes; else of the whole computer, as the nodes' is not known.
    """

    metrics: tuple[str, ...]
    runs: int
    known: int
    whose: tuple[int | str, ...]
    largest: float
    of_nodes: bool


def high_load(study: Study, evaluations: Iterable[Evaluation]) -> HighLoad | None:
    """Return in which runs the load was high; None if in none that counts."""
    metrics: dict[str, None] = {}
    high: list[tuple[Evaluation, float, bool]] = []
    known = 0
    for evaluation in evaluations:
        outcome = evaluation.outcome
        names = by_the_clock(study, outcome) if outcome.complete else []
        if outcome.load is None or not names:
            continue
        of_nodes = outcome.load.nodes is not None
        share = outcome.load.nodes if of_nodes else outcome.load.machine
        if share is None:
            continue
        known += 1
        if share >= HIGH:
            metrics |= dict.fromkeys(names)
            high.append((evaluation, share, of_nodes))
    if not high:
        return None
    _, largest, of_nodes = max(high, key=lambda item: item[1])
    return HighLoad(
        tuple(study.metrics[name].title for name in metrics),
        len(high),
        known,
        tuple(dict.fromkeys(evaluation.whose for evaluation, _, _ in high)),
        largest,
        of_nodes,
    )


def by_the_clock(study: Study, outcome: Outcome) -> list[str]:
    """Return the limited times, by the names of their metrics, that have waiting in them."""
    without = {COMPUTING, MODELLED}
    return [name for name in _limited_times(study) if _sources(study, name, outcome) - without]


def times_by(study: Study, evaluations: Iterable[Evaluation], source: str) -> list[str]:
    """Return the limited times, by the names of their metrics, of one source in every run."""
    outcomes = [e.outcome for e in evaluations if e.outcome.complete]
    return [
        name
        for name in _limited_times(study)
        if outcomes and all(_sources(study, name, outcome) == {source} for outcome in outcomes)
    ]


def _limited_times(study: Study) -> list[str]:
    limited = dict.fromkeys(constraint.metric for constraint in study.constraints.values())
    return [name for name in limited if study.metrics[name].measures_time]


def _sources(study: Study, name: str, outcome: Outcome) -> set[str]:
    """Return how the nodes have obtained the times that a metric is made of."""
    return {_source(part, outcome.details) for part in _times_in(study.metrics[name])}


def _times_in(metric: StudyMetric) -> Iterator[ReportedMetric]:
    if isinstance(metric, ReportedMetric) and metric.measures_time:
        yield metric
    if isinstance(metric, COMPUTED):
        for part in metric.parts:
            yield from _times_in(part)


def _source(metric: ReportedMetric, details: Mapping[str, str]) -> str:
    """Return the source whose key shares the longest beginning with that of the time."""
    stems = [
        stem
        for key in details
        if key.endswith(SOURCE)
        and f"{metric.node}.{metric.key}".startswith(stem := key.removesuffix(SOURCE))
    ]
    return details[f"{max(stems, key=len)}{SOURCE}"] if stems else ""
