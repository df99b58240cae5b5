"""Optuna: a sampler for its studies, and its trials as earlier runs."""

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from optuna import Study as OptunaStudy
from optuna import Trial as OptunaTrial
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)
from optuna.samplers import BaseSampler
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState

from bo_tuner.api.earlier import EarlierRun
from bo_tuner.api.result import Result
from bo_tuner.api.study import Study
from bo_tuner.api.tuner import Run
from bo_tuner.codec import checks
from bo_tuner.errors import RunError, StudyError, UnknownRunError
from bo_tuner.study.function_study import returned_metrics
from bo_tuner.text import counted
from bo_tuner.trials import Value

PRUNED = "pruned"
"""Why a run failed whose trial was pruned."""


class BoTunerSampler(BaseSampler):
    """Lets an Optuna study carry out a run: each of its trials is one run, in one context.

    The objective suggests parameters and context variables by their names in the study, in any
    order. It returns the metric of the objective (several: with `further_objectives`) and sets each
    other metric by ``trial.set_user_attr(name, value)``. `run` has the seed of the noise. A run
    that fails for its parameters raises ``optuna.TrialPruned``. A trial that fails otherwise, or is
    interrupted, tells nothing of them, as in Optuna: its run is made again by the next one.

    The Optuna study ends with the run. Its best trial is the luckiest single run; what is to be set
    is `result`. It is for one job at a time.

    Parameters
    ----------
    study
        The study.
    folder, algorithm
        As in `Study.tuner`.
    """

    def __init__(
        self, study: Study, folder: str | Path | None = None, *, algorithm: str | None = None
    ) -> None:
        self._study = study
        self._tuner = study.tuner(folder, algorithm=algorithm)
        self._run = self._tuner.ask()
        self._trial = -1

    def run(self, trial: OptunaTrial | FrozenTrial) -> Run:
        """Return the run that a trial carries out, with its context and seed.

        Raises
        ------
        UnknownRunError
            If it carries out none any more.
        RunError
            If all runs are made.
        """
        if self._run is None:
            raise RunError("the run is over; its result is sampler.result()")
        if trial.number != self._trial:
            raise UnknownRunError(
                f"trial {trial.number} is not the one that is under way: one job at a time "
                "(n_jobs=1)"
            )
        return self._run

    def result(self) -> Result:
        """Return what is known so far; once the Optuna study has ended, the result."""
        return self._tuner.result()

    def close(self) -> None:
        """Let others work in the folder."""
        self._tuner.close()

    def before_trial(self, study: OptunaStudy, trial: FrozenTrial) -> None:
        """Take the trial for the run that is due."""
        objectives = self._study.checked.objectives
        expected = [StudyDirection[objective.direction.upper()] for objective in objectives]
        if study.directions != expected:
            wanted = [f"{o.direction} {o.metric}" for o in objectives]
            found = [direction.name.lower() for direction in study.directions]
            raise StudyError(
                f"expected an Optuna study to {' and '.join(wanted)}, as the study of this "
                f"sampler, found one with {counted(len(found), 'direction')}: {', '.join(found)}"
            )
        self._trial = trial.number
        self.run(trial)

    def infer_relative_search_space(
        self, study: OptunaStudy, trial: FrozenTrial
    ) -> dict[str, BaseDistribution]:
        """Return nothing: what the objective suggests is looked up by its name."""
        return {}

    def sample_relative(
        self, study: OptunaStudy, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """Return the values of what is looked up anyway, one by one."""
        return {
            name: self.sample_independent(study, trial, name, distribution)
            for name, distribution in search_space.items()
        }

    def sample_independent(
        self,
        study: OptunaStudy,
        trial: FrozenTrial,
        param_name: str,
        param_distribution: BaseDistribution,
    ) -> Any:
        """Return the value of a parameter or a context variable.

        Raises
        ------
        StudyError
            If the study does not have it, or the objective does not suggest such a value.
        """
        run = self.run(trial)
        values = {**run.context, **run.parameters}
        if param_name not in values:
            known = checks.suggestion(param_name, values)
            raise StudyError(f"is no parameter and no context of the study; {known}", (param_name,))
        return _suggested(param_name, values[param_name], param_distribution)

    def after_trial(
        self,
        study: OptunaStudy,
        trial: FrozenTrial,
        state: TrialState,
        values: Sequence[float] | None,
    ) -> None:
        """Tell the result, and end the Optuna study with the run.

        Raises
        ------
        MetricsError
            If a metric is missing or no number.
        StudyError
            If the values of the trial are not those of the run, or not all of them.
        RunError
            If three trials in a row have failed.
        """
        run = self.run(trial)
        _check_suggested(run, trial)
        if state is TrialState.COMPLETE:
            _check_all_suggested(run, trial)
            self._tuner.tell(run, _metrics(self._study, trial, values or []))
        elif state is TrialState.PRUNED:
            self._tuner.fail(run, PRUNED)
        else:
            self._tuner.lose(run, "the objective failed, returned no number, or was interrupted")
        self._run = self._tuner.ask()
        self._trial = -1
        if self._run is None:
            # It is none who asks and tells.
            with contextlib.suppress(RuntimeError):
                study.stop()


def _suggested(name: str, value: Value, distribution: BaseDistribution) -> Any:
    """Return the value of a distribution that stands for one of the study.

    Choices that are no texts have theirs in the study: ``"None"`` stands for None.

    Raises
    ------
    StudyError
        If there is none.
    """
    if isinstance(distribution, FloatDistribution | IntDistribution):
        low, high = distribution.low, distribution.high
        if not isinstance(value, int | float) or not low <= value <= high:
            raise StudyError(
                f"expected a range with {checks.show(value)}, found {low:g} to {high:g}", (name,)
            )
        return value
    choices = distribution.choices if isinstance(distribution, CategoricalDistribution) else ()
    # Of different types 1 would be True.
    same: list[object] = [c for c in choices if type(c) is type(value) and c == value]
    if not (same := same or [choice for choice in choices if str(choice) == value]):
        found = ", ".join(map(checks.show, choices))
        raise StudyError(f"expected choices with {checks.show(value)}, found {found}", (name,))
    return same[0]


def _check_suggested(run: Run, trial: FrozenTrial) -> None:
    """Refuse values that are not those of the run, as of a trial that was enqueued."""
    asked = {**run.context, **run.parameters}
    for name, value in trial.params.items():
        if name not in asked:
            continue
        expected = _suggested(name, asked[name], trial.distributions[name])
        if value != expected:
            raise StudyError(
                f"expected {checks.show(expected)}, as asked for, found {checks.show(value)}: "
                "trials cannot be enqueued (the study's `start` has values to begin with), nor "
                "parameters fixed (its `parameters` can fix them)",
                (name,),
            )


def _check_all_suggested(run: Run, trial: FrozenTrial) -> None:
    """Refuse the result of an objective that has not applied all values."""
    for name, value in {**run.context, **run.parameters}.items():
        if name not in trial.params:
            raise StudyError(
                f"expected the objective to suggest it and to run with {checks.show(value)}, "
                "found that it has not",
                (name,),
            )


def earlier_runs(study: Study, optuna_study: OptunaStudy) -> list[EarlierRun]:
    """Return the trials of an Optuna study as earlier runs, for `Study.optimize`.

    Those that failed tell nothing, and are left out; those that were pruned failed for their
    parameters.

    Parameters
    ----------
    study
        The study, which has at least those parameters and context variables of the same names.
    optuna_study
        Its objective minimizes the objectives of the study; other metrics are user attributes of
        its trials.

    Raises
    ------
    MetricsError
        When these are used, if a trial has not a number for each metric.
    """
    names = study.checked.parameters
    return [
        EarlierRun(
            {
                name: str(value) if isinstance(names[name].default, str) else value
                for name, value in trial.params.items()
                if name in names
            },
            _metrics(study, trial, trial.values or []),
            {name: value for name, value in trial.params.items() if name not in names},
            PRUNED if trial.state is TrialState.PRUNED else "",
        )
        for trial in optuna_study.trials
        if trial.state in (TrialState.COMPLETE, TrialState.PRUNED)
    ]


def _metrics(study: Study, trial: FrozenTrial, values: Sequence[float]) -> dict[str, float]:
    """Return the metrics of a trial: what it returned, and its attributes of their names."""
    inner = study.checked
    reported = dict(zip((o.metric for o in inner.objectives), values, strict=False))
    reported |= trial.user_attrs
    return {name: reported[name] for name in returned_metrics(inner) if name in reported}
