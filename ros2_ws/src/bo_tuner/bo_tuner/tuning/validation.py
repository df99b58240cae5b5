"""Validation of parameter sets on fresh draws of context and noise (Sec. 5.2)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bo_tuner.backends.protocol import Backend
from bo_tuner.errors import RunError
from bo_tuner.numerics.seeds import Stream, generator, noise_seed
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, EvaluationState, Stage, Value
from bo_tuner.tuning.loop import LOST_IN_A_ROW, EvaluationObserver, run_cut


@dataclass(frozen=True)
class ConstraintCheck:
    """How a constraint fared in a validation.

    Attributes
    ----------
    name
        The constraint.
    worst
        Largest value of its metric.
    violations
        Draws above the limit.
    holds
        For a worst case: without any violation. For a chance constraint: with at least the
        required share of draws within the limit.
    """

    name: str
    worst: float
    violations: int
    holds: bool


@dataclass(frozen=True)
class Validation:
    """What fresh draws say of one parameter set.

    Attributes
    ----------
    parameters
        The parameter set.
    draws, failures
        Number of evaluations, and of those that failed.
    objective, deviation
        Mean of the objective's metric over the whole evaluations, and its standard deviation.
    constraints
        How each constraint fared.
    """

    parameters: Mapping[str, Value]
    draws: int
    failures: int
    objective: float
    deviation: float
    constraints: tuple[ConstraintCheck, ...]

    @property
    def feasible(self) -> bool:
        """Whether no evaluation failed and every constraint holds."""
        return self.failures == 0 and all(check.holds for check in self.constraints)


def validate(
    study: Study,
    backend: Backend,
    parametrizations: Sequence[Mapping[str, Value]],
    *,
    observe: EvaluationObserver = lambda evaluation, parameters: None,
    advance: Callable[[], None] = lambda: None,
) -> list[Validation]:
    """Run each parameter set on the same fresh draws.

    Parameters
    ----------
    study
        Its budget says how many draws.
    backend
        Runs the evaluations; open.
    parameter sets
        Compared on equal contexts and noise.
    observe
        Called after each evaluation.
    advance
        Called after each draw, for progress.

    Raises
    ------
    RunError
        If three evaluations in a row were lost with their nodes.
    """
    contexts = study.context_space()
    rng = generator(study.seed, Stream.VALIDATION_CONTEXTS)
    drawn = contexts.draw(study.budget.validation_draws, rng)
    evaluations: list[list[Evaluation]] = [[] for _ in parametrizations]
    lost = 0
    for k, row in enumerate(drawn):
        seed = noise_seed(study.seed, Stream.VALIDATION_NOISE, k)
        context = contexts.to_dict(row)
        for number, parameters in enumerate(parametrizations):
            planned = Evaluation(number, k, Stage.VALIDATION, context, seed)
            evaluation = run_cut(study, backend, parameters, planned)
            evaluations[number].append(evaluation)
            observe(evaluation, parameters)
            lost = lost + 1 if evaluation.outcome.state is EvaluationState.LOST else 0
            if lost >= LOST_IN_A_ROW:
                raise RunError(
                    f"{lost} runs in a row were lost with their nodes: {evaluation.outcome.reason}"
                )
        advance()
    return [_judge(study, p, c) for p, c in zip(parametrizations, evaluations, strict=True)]


def _judge(
    study: Study, parameters: Mapping[str, Value], evaluations: Sequence[Evaluation]
) -> Validation:
    whole = [
        evaluation.outcome.metrics
        for evaluation in evaluations
        if evaluation.outcome.state is EvaluationState.COMPLETE
    ]
    objective = np.array([metrics[study.objective.metric] for metrics in whole])
    checks = []
    for constraint in study.constraints.values():
        values = np.array([metrics[constraint.metric] for metrics in whole])
        violations = int(np.sum(values > constraint.upper))
        checks.append(
            ConstraintCheck(
                name=constraint.name,
                worst=float(values.max()) if len(values) else float("nan"),
                violations=violations,
                holds=len(values) > 0 and violations <= constraint.allowed * len(values) + 1e-9,
            )
        )
    return Validation(
        parameters=dict(parameters),
        draws=len(evaluations),
        failures=len(evaluations) - len(whole),
        objective=float(objective.mean()) if len(whole) else float("nan"),
        deviation=float(objective.std(ddof=1)) if len(whole) > 1 else float("nan"),
        constraints=tuple(checks),
    )
