"""Whether a machine has drifted since a certificate: fresh runs beside those of that time.

The baseline are the runs of the certificate in draws from the contexts; without contexts, all its
runs are of one distribution, and count. Each metric is tested by ranks after every fresh run
(`numerics.rank_drift`), with an equal share of the probability of a false alarm.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path

import numpy as np

from bo_tuner.codec.writing import to_json
from bo_tuner.errors import RunError, RunRecordError
from bo_tuner.evidence.certificate.certificate import Certificate
from bo_tuner.evidence.certificate.evaluations_file import read_evaluations
from bo_tuner.evidence.certificate.store import evaluations_problem
from bo_tuner.numerics.rank_drift import RankTest
from bo_tuner.numerics.seeds import Stream, generator, noise_seed
from bo_tuner.plans import Plan, Run
from bo_tuner.storage.atomic import write_atomically, writing
from bo_tuner.storage.numbered_files import next_number, numbered_path
from bo_tuner.storage.provenance import study_sha256
from bo_tuner.study.study import Study
from bo_tuner.trials import TUNED, Evaluation, Outcome, Stage, Value

DRIFT = "drift"
"""Folder of the comparisons in a run folder, and the name of their phase."""
LEAST_BASELINE = 10
"""Baseline runs that a comparison takes at least."""
MOST_BASELINE = 200
"""Baseline runs that are compared at most, the latest: more add little."""
POWER = 0.95
"""Probability with which an effect that is stated is found."""
BASELINES = 0.95
"""Share of all baselines that have at most the stated rate of false alarms."""


@dataclass(frozen=True)
class Compared:
    """A metric in the baseline and in the fresh runs.

    Attributes
    ----------
    metric, unit
        The metric.
    baseline, fresh
        Medians of the runs, in its unit; infinite if half of them failed.
    deviation
        Standard deviation of the baseline.
    found_after
        The number of fresh runs after which a drift was found; None without one.
    """

    metric: str
    unit: str
    baseline: float
    fresh: float
    deviation: float
    found_after: int | None


@dataclass(frozen=True, kw_only=True)
class Drift:
    """The result of a comparison.

    Attributes
    ----------
    certificate
        Name of the certificate's file.
    parameters
        The parameter set.
    baseline, fresh
        Numbers of runs.
    failed
        How many of the fresh runs failed; a failed run counts as beyond every other.
    false_alarms
        Probability of a drift in any metric where there is none, at most, over all baselines.
    rate
        The same with one baseline again and again, for the share `BASELINES` of all baselines of so
        many runs.
    effect
        The shift of one metric, in standard deviations of a run, that is found with the probability
        `POWER` within the fresh runs that were allowed; infinite if none is.
    metrics
        Each metric.
    started, finished
        When.
    """

    certificate: str
    parameters: Mapping[str, Value]
    baseline: int
    fresh: int
    failed: int
    false_alarms: float
    rate: float
    effect: float
    metrics: tuple[Compared, ...]
    started: str
    finished: str

    @property
    def drifted(self) -> tuple[str, ...]:
        """The metrics that have drifted."""
        return tuple(item.metric for item in self.metrics if item.found_after is not None)


def baseline_runs(path: Path, certificate: Certificate, study: Study) -> list[Outcome]:
    """Return what the runs of a certificate's parameter set have given, in their order."""
    if certificate.study_sha256 != study_sha256(study):
        raise RunRecordError(f"{path}: belongs to another version of the study; run validate again")
    if problem := evaluations_problem(path, certificate):
        raise RunRecordError(f"{path}: has no baseline runs: {problem}; run validate again")
    rows = [
        row.outcome
        for row in read_evaluations(path)
        if row.parameter_set == TUNED
        and not row.outcome.unusable
        and (row.stage is Stage.VALIDATION or not study.contexts)
    ]
    complete = sum(outcome.complete for outcome in rows)
    if complete < LEAST_BASELINE:
        raise RunRecordError(
            f"{path}: has {complete} complete baseline runs; expected at least "
            f"{LEAST_BASELINE}: run validate again, with more --runs"
        )
    return rows[-MOST_BASELINE:]


class DriftPlan(Plan[Run]):
    """Fresh runs until a metric has drifted.

    Attributes
    ----------
    parameters, false_alarms
        As given.
    evaluations
        The fresh runs that count, in their order.
    test
        Of one metric.
    """

    phase = DRIFT
    what = "fresh runs"
    attempts = 2

    def __init__(
        self,
        study: Study,
        parameters: Mapping[str, Value],
        baseline: Sequence[Outcome],
        metrics: Sequence[str],
        most: int,
        false_alarms: float,
        number: int,
    ) -> None:
        self.steps = most
        self.test = RankTest(len(baseline), most, false_alarms / len(metrics))
        self.evaluations: list[Evaluation] = []
        self._study = study
        self.parameters = parameters
        self.false_alarms = false_alarms
        self._metrics = {name: _values(baseline, name) for name in metrics}
        self._number = number
        contexts = study.context_space().draw(most, generator(study.seed, Stream.DRIFT, number))
        self._contexts = [study.context_space().to_dict(context) for context in contexts]
        self._planned = 0

    def ask(self, pending: Sequence[Run]) -> Run | None:
        """Return the next fresh run."""
        if self._planned == self.steps or any(self.found_after.values()):
            return None
        k = self._planned
        self._planned += 1
        seed = noise_seed(self._study.seed, Stream.DRIFT, self._number, k)
        return Run(Evaluation(0, k, Stage.VALIDATION, self.parameters, self._contexts[k], seed))

    def tell(self, task: Run) -> bool:
        """Add a run, unless it says nothing of the parameters."""
        if not task.evaluation.outcome.unusable:
            self.evaluations.append(task.evaluation)
        return True

    @property
    def found_after(self) -> dict[str, int | None]:
        """By metric, the number of runs after which a drift was found; None without one."""
        outcomes = [evaluation.outcome for evaluation in self.evaluations]
        return {
            name: self.test.found_after(baseline, _values(outcomes, name))
            for name, baseline in self._metrics.items()
        }

    @property
    def rate(self) -> float:
        """The rate of false alarms in any metric, with one baseline of so many runs."""
        count = len(self._metrics)
        return min(1.0, count * self.test.rate(1.0 - (1.0 - BASELINES) / count))

    @property
    def compared(self) -> tuple[Compared, ...]:
        """Each metric in both."""
        outcomes = [evaluation.outcome for evaluation in self.evaluations]
        return tuple(
            Compared(
                name,
                self._study.metrics[name].unit,
                float(np.median(self._metrics[name])),
                float(np.median(_values(outcomes, name))),
                float(np.std([value for value in self._metrics[name] if value < inf])),
                found,
            )
            for name, found in self.found_after.items()
        )


def _values(outcomes: Sequence[Outcome], metric: str) -> list[float]:
    """Return the values of a metric; of a failed run an infinite one."""
    return [o.metrics[metric] if o.complete else inf for o in outcomes]


def result_of(plan: DriftPlan, certificate: str, started: str, finished: str) -> Drift:
    """Return the result of a plan that was carried out."""
    if not plan.evaluations:
        raise RunError("no fresh run was usable: nodes were lost or disturbed in all of them")
    return Drift(
        certificate=certificate,
        parameters=plan.parameters,
        baseline=plan.test.baseline,
        fresh=len(plan.evaluations),
        failed=sum(not run.outcome.complete for run in plan.evaluations),
        false_alarms=plan.false_alarms,
        rate=plan.rate,
        effect=plan.test.effect(POWER),
        metrics=plan.compared,
        started=started,
        finished=finished,
    )


def next_number_of(folder: Path) -> int:
    """Return the number of the next comparison in a run folder, from 1."""
    return next_number(folder / DRIFT)


def write_drift(folder: Path, number: int, drift: Drift, runs: Sequence[Evaluation]) -> Path:
    """Write a comparison with its fresh runs, and return the path."""
    directory = folder / DRIFT
    with writing(directory):
        directory.mkdir(exist_ok=True)
    content = {
        "drifted": drift.drifted,
        **to_json(drift),
        "runs": [
            {
                "context": dict(run.context),
                "seed": run.seed,
                "state": str(run.outcome.state),
                "reason": run.outcome.reason,
                "metrics": dict(run.outcome.metrics),
            }
            for run in runs
        ],
    }
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    return write_atomically(numbered_path(directory, number), text)
