"""The data behind a report: the trials of a run, the models of them, and the answer."""

import math
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from bo_tuner.deploy.bundle import result_of
from bo_tuner.errors import RunRecordError
from bo_tuner.evidence.certificate.certificate import Certificate
from bo_tuner.evidence.differences import CONFIDENCE
from bo_tuner.evidence.estimates import Estimate, Source, of_runs
from bo_tuner.evidence.run_verdict import run_verdict
from bo_tuner.evidence.trial_row import TrialOutcome, outcome_of
from bo_tuner.evidence.verdict import Verdict
from bo_tuner.figures.figure import Panel
from bo_tuner.models.surrogates import Surrogates
from bo_tuner.numerics.arrays import Array
from bo_tuner.optimizers.ranking import Candidate, Ranking
from bo_tuner.report.content import Section
from bo_tuner.report.sections.certificate import certificate
from bo_tuner.report.time_response import Responses
from bo_tuner.storage.record import RunRecord
from bo_tuner.study.parts import Objective
from bo_tuner.study.study import Study
from bo_tuner.study.titles import titled_values
from bo_tuner.trials import CHECKS, Evaluation, Trial, TrialState, Value
from bo_tuner.tuning.recorded_method import recorded_method

T = TypeVar("T")


K = TypeVar("K", bound=Hashable)


@dataclass(frozen=True, eq=False)
class Known:
    """Results that trials to come do not change, as far as they have been computed.

    Attributes
    ----------
    incumbents
        By the number of trials that they are the best of.
    trajectories
        Panels of simulated signals, by the name and number of a trial and the contexts.
    responses
        Signals of default and answer, by the name and number of a trial and the evaluations.
    """

    incumbents: dict[int, Candidate | None] = field(default_factory=dict)
    trajectories: dict[tuple[str, int, str], list[Panel]] = field(default_factory=dict)
    responses: dict[tuple[str, int, int], Responses] = field(default_factory=dict)


def remembered(known: dict[K, T], key: K, make: Callable[[], T]) -> T:
    """Return what is known by a key; what is not is made first."""
    if key not in known:
        known[key] = make()
    return known[key]


NOT_BLIND = 0.5
"""Least probability of a trial that is in the models, for their predictions to count."""


@dataclass(frozen=True, eq=False)
class Analysis:
    """A run with the models of all its trials.

    Attributes
    ----------
    record
        The run.
    known
        A page of a run in progress hands it on from one analysis to the next.
    quick
        Whether to leave out what may take longer than a trial.
    """

    record: RunRecord
    known: Known = field(default_factory=Known)
    quick: bool = False

    @property
    def study(self) -> Study:
        """The study of the run, with its command-line options."""
        return self.record.study

    @cached_property
    def trials(self) -> tuple[Trial, ...]:
        """The trials, each with the evaluations that checked it as a candidate.

        Worst cases are those on record; of a trial that was run again they are estimated anew.
        """
        return tuple(
            recorded_method(self.record).estimated(self.study, self.models, trial)
            if len(trial.evaluations) > len(trial.unchecked.evaluations)
            else trial
            for trial in self._checked
        )

    @cached_property
    def has_checks(self) -> bool:
        """Whether trials have evaluations that checked them as candidates."""
        return any(evaluation.stage in CHECKS for evaluation in self.record.evaluations)

    @cached_property
    def _checked(self) -> tuple[Trial, ...]:
        """All trials, with the worst cases that were estimated when they were run."""
        record = self.record
        return tuple(recorded_method(record).checked(self.study, record.trials, record.evaluations))

    @property
    def _ranking(self) -> Ranking[Surrogates]:
        return recorded_method(self.record).ranking

    @cached_property
    def models(self) -> Surrogates:
        """Surrogates of all trials, those of the ranking."""
        return self._ranking.models(self.study, self._checked)

    @cached_property
    def ranked(self) -> list[Candidate]:
        """Complete trials, the recommended one first."""
        return self._ranking.ranked_by(self.models, self.study, self.trials)

    @cached_property
    def leader(self) -> Candidate | None:
        """The first of `ranked`; None without a complete trial."""
        return self._ranking.first_by(self.models, self.study, self.trials)

    @cached_property
    def comparable(self) -> list[Trial]:
        """The trials of `ranked`, in the order of the run."""
        return self._ranking.comparable(self.models, self.study, self.trials)

    @property
    def certificate(self) -> Certificate | None:
        """The certificate, if `validate` has written one and it can be read."""
        with_section, _ = self._certificate
        return None if with_section is None else with_section[0]

    @property
    def certificate_section(self) -> Section | None:
        """The section on the certificate, if there is one and it can be read."""
        with_section, _ = self._certificate
        return None if with_section is None else with_section[1]

    @property
    def certificate_problem(self) -> str:
        """Why the certificate cannot be read; empty if it can, or there is none."""
        return self._certificate[1]

    @cached_property
    def _certificate(self) -> tuple[tuple[Certificate, Section] | None, str]:
        try:
            return certificate(self.record, self.answer), ""
        except RunRecordError as error:
            return None, str(error)

    @cached_property
    def answer(self) -> Trial | None:
        """The trial of the result; before there is one, the trial recommended so far."""
        if self.record.summary is None:
            return self.leader.trial if self.leader else None
        number = result_of(self.record).number
        return next(trial for trial in self.trials if trial.number == number)

    @property
    def answer_name(self) -> str:
        """What charts call the `answer`."""
        return "best so far" if self.record.summary is None else "tuned"

    @property
    def answer_set(self) -> str:
        """What sentences call the parameter set of the `answer`."""
        return "best parameter set so far" if self.record.summary is None else "tuned parameter set"

    @cached_property
    def verdict(self) -> Verdict:
        """The verdict on the result."""
        return run_verdict(self.record)

    @property
    def defaults(self) -> Mapping[str, Value]:
        """The hand-tuned parameter set."""
        return self.study.search_space().defaults

    @cached_property
    def _outcomes(self) -> dict[int, tuple[Trial, TrialOutcome]]:
        """Outcomes by the identity of a trial, which is kept so that no other one can have it."""
        return {}

    def outcome(self, trial: Trial) -> TrialOutcome:
        """Return the outcome of a trial, which each figure of a long run asks for."""
        _, outcome = remembered(self._outcomes, id(trial), lambda: (trial, self._outcome(trial)))
        return outcome

    def _outcome(self, trial: Trial) -> TrialOutcome:
        complete = trial.state is TrialState.COMPLETE
        if complete and trial.number in self.models.outliers:
            return TrialOutcome.OUTLIER
        return outcome_of(self.study, trial)

    def blind(self, points: Array) -> NDArray[np.bool_]:
        """Return where trials nearby are not in the models, at points (n, d) of the unit cube.

        They failed, or were outliers of the objective: what the models predict there is that of
        trials farther away.
        """
        good = np.sum([c.log_complement(points) for c in self.models.classifiers], axis=0)
        is_blind: NDArray[np.bool_] = np.broadcast_to(np.exp(good), len(points)) < NOT_BLIND
        return is_blind

    def estimate(self, trial: Trial, metric: str) -> Estimate:
        """Return what the tuning says of the mean of an objective's metric.

        By the models of all runs, as far as the trial is in them, and else by its own draws.
        """
        modelled = self._modelled.get(metric, {}).get(trial.number)
        return modelled or of_runs(trial.observations(metric), Source.TUNING)

    def fresh_estimate(self, trial: Trial, metric: str) -> Estimate | None:
        """Return what the verdict has of the mean of a metric; None of most trials."""
        sides = (self.defaults, {} if self.answer is None else self.answer.parameters)
        if self.verdict.trial is None:
            return None
        for quantity in self.verdict.quantities:
            if quantity.metric == metric and quantity.estimates is not None:
                for parameters, estimate in zip(sides, quantity.estimates, strict=True):
                    if dict(parameters) == dict(trial.parameters) and estimate.count:
                        return estimate
        return None

    @cached_property
    def _modelled(self) -> dict[str, dict[int, Estimate]]:
        """Estimates by the models: by the metric of an objective, and the number of a trial."""
        study, models = self.study, dict(self.models.costs)
        if len(study.objectives) == 1 and self.models.objective is not None:
            models = {study.objective.metric: self.models.objective}
        trials = [
            trial
            for trial in self.trials
            if trial.state is TrialState.COMPLETE and trial.number not in self.models.outliers
        ]
        if study.a_run_tells_all or not trials:
            return {}
        points = study.search_space().cube_of(trial.parameters for trial in trials)
        found: dict[str, dict[int, Estimate]] = {}
        for objective in study.objectives:
            if (model := models.get(objective.metric)) is not None:
                predicted = zip(trials, *model.predict(points), strict=True)
                found[objective.metric] = {
                    trial.number: _by_model(objective, trial, cost, variance)
                    for trial, cost, variance in predicted
                }
        return found

    @property
    def means_in_words(self) -> str:
        """Where the means of `estimate` are from."""
        return "by the models of all test runs" if self._modelled else "over its own test runs"

    def tuned_values(self, parameters: Mapping[str, Value]) -> dict[str, Value]:
        """Return the tuned ones among `parameters`."""
        return {name: parameters[name] for name in self.study.tuned_names}

    def numbers_of(self, trial: Trial) -> list[str]:
        """Return the names of the tuned numbers that a trial's parameter set has."""
        space = self.study.search_space()
        inactive = space.inactive(self.tuned_values(trial.parameters))
        return [name for name in space.numbers if name not in inactive]

    def tuned_in_words(self, parameters: Mapping[str, Value]) -> str:
        """Return the tuned ones among `parameters` in a line."""
        active = self.study.search_space().active(self.tuned_values(parameters))
        return titled_values(self.study.parameters, active)

    def evaluations_of(self, parameters: Mapping[str, Value]) -> list[Evaluation]:
        """Return the complete evaluations of a parameter set, of any stage."""
        space = self.study.search_space()
        key = space.key(self.tuned_values(parameters))
        return [
            evaluation
            for evaluation in self.record.evaluations
            if evaluation.outcome.complete and space.key(evaluation.parameters) == key
        ]


def _by_model(objective: Objective, trial: Trial, cost: float, variance: float) -> Estimate:
    """Return the estimate of a model of the cost at a trial."""
    quantile = float(ndtri(0.5 + 0.5 * CONFIDENCE))
    half = quantile * math.sqrt(variance)
    low, high = sorted(float(objective.from_cost(cost + side * half)) for side in (-1.0, 1.0))
    return Estimate(
        value=float(objective.from_cost(cost)),
        error=0.5 * (high - low) / quantile,
        count=sum(evaluation.outcome.complete for evaluation in trial.evaluations),
        source=Source.MODEL,
        adjusted=False,
        low=low,
        high=high,
    )
