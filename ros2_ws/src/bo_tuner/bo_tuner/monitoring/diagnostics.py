"""A run as diagnostics (REP-107), independent of ROS messages."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from bo_tuner.evidence.words.verdict import headline
from bo_tuner.models.categories import Coding
from bo_tuner.models.hyperpriors import Hyperparameters
from bo_tuner.monitoring.status import Snapshot
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.storage.run_files import BAGS, trial_bag
from bo_tuner.study.limits import keeps_limits, outcome_in_words, tightest
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, TrialState

PROGRESS, SURROGATE, SAFETY = "tuner: progress", "tuner: surrogate", "tuner: safety"
TRIAL_RESULT = "tuner: trial_result"
"""Names of the statuses. They never change, so that plotters draw one series of each value."""


class Level(IntEnum):
    """Levels of a status, those of ``diagnostic_msgs/DiagnosticStatus``."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(frozen=True)
class Status:
    """A named status.

    Attributes
    ----------
    name
        One of the names above.
    level
        Severity.
    message
        Short summary.
    values
        Details by key; numbers in SI units, written so that reading them back is exact.
    """

    name: str
    level: Level
    message: str
    values: Mapping[str, str] = field(default_factory=dict)


def progress(study: Study, now: Snapshot) -> Status:
    """Return the progress of a run as a status."""
    message = f"{now.phase}: {now.done} of {now.total}" if now.phase else "starting"
    values: dict[str, object] = {
        "phase": now.phase,
        "done": now.done,
        "total": now.total,
        "trials": now.trials,
        "budget": study.budget.trials,
        "paused": now.paused,
        "overhead": now.overhead,
        "time_left": now.time_left,
        **_of_incumbent(now.incumbent),
        "stop_advised": now.advice is not None,
    }
    if now.advice is not None:
        values |= {"expected_gain": now.advice.expected_gain, "noise": now.advice.noise}
        message += "; advice: stop, the expected gain is below the noise"
    if now.incumbent is not None and not now.incumbent.believed_feasible:
        message += "; no feasible point yet"
    if now.paused:
        message += "; paused"
    if now.verdict is None:
        return Status(PROGRESS, Level.OK, message, _text(values))
    values |= {
        "verdict": str(now.verdict.state),
        "feasible": now.verdict.feasible,
        "result": now.verdict.trial,
    }
    level = Level.OK if now.verdict.feasible else Level.WARN
    return Status(PROGRESS, level, headline(now.verdict), _text(values))


def surrogate(study: Study, now: Snapshot) -> Status:
    """Return the hyperparameters and warnings of the latest proposal as a status."""
    last = now.last
    values: dict[str, object] = {"fallbacks": now.fallbacks}
    if last is None:
        return Status(SURROGATE, Level.OK, "no model yet", _text(values))
    level = Level.WARN if last.warnings else Level.OK
    if not last.hyperparameters:
        message = last.warnings[0] if last.warnings else "no model yet"
        return Status(SURROGATE, level, message, _text(values))
    space = study.search_space()
    columns = [*space.names, *study.context_space().columns, *study.measured]
    names = Coding(space.levels).names(columns)
    for model, phi in last.hyperparameters.items():
        hyperparameters = Hyperparameters.from_log(np.array(phi))
        scales = zip(names, hyperparameters.length_scales.tolist(), strict=False)
        values |= {f"{model}.length_scale.{name}": scale for name, scale in scales}
        values |= {
            f"{model}.signal": hyperparameters.signal,
            f"{model}.noise": hyperparameters.noise,
        }
    message = last.warnings[0] if last.warnings else f"trial {last.number}: {last.origin}"
    return Status(SURROGATE, level, message, _text(values))


def safety(study: Study, now: Snapshot) -> Status:
    """Return the numbers of failures and violations as a status, at the latest trial's level."""
    values = {
        "failed_trials": now.failed,
        "violating_trials": now.violating,
        "lost_evaluations": now.lost,
    }
    if now.last is None:
        return Status(SAFETY, Level.OK, "no trial yet", _text(values))
    message = f"trial {now.last.number}: {now.last.reason or outcome_in_words(study, now.last)}"
    return Status(SAFETY, _level(study, now.last), message, _text(values))


def trial_result(study: Study, trial: Trial, incumbent: Candidate | None, run: str) -> Status:
    """Return the result of a trial as a status."""
    values: dict[str, object] = {
        "trial": trial.number,
        "state": str(trial.state),
        "origin": trial.origin,
        "verdict": outcome_in_words(study, trial),
        **{
            f"parameters.{name}": value
            for name, value in study.search_space().active(trial.parameters).items()
        },
    }
    if trial.state is TrialState.COMPLETE:
        for name in study.metrics:
            values[f"metrics.{name}"] = trial.mean(name)
    if (tightest_constraint := tightest(study, trial)) is not None:
        constraint, worst = tightest_constraint
        values |= {"worst_constraint": constraint.name, "worst_case": worst.value}
        values |= {f"worst_context.{name}": value for name, value in worst.context.items()}
    values |= {
        **_of_incumbent(incumbent),
        "evaluations": len(trial.evaluations),
        "optimizer_seconds": trial.seconds,
        "evaluation_seconds": sum(evaluation.seconds for evaluation in trial.evaluations),
        "seed": study.seed,
        "bag": f"{run}/{BAGS}/{trial_bag(trial.number)}",
    }
    message = trial.reason or outcome_in_words(study, trial)
    return Status(TRIAL_RESULT, _level(study, trial), message, _text(values))


def _level(study: Study, trial: Trial) -> Level:
    if trial.state is TrialState.FAILED:
        return Level.ERROR
    return Level.OK if keeps_limits(study, trial) else Level.WARN


def _of_incumbent(best: Candidate | None) -> dict[str, object]:
    if best is None:
        return {}
    return {
        "incumbent": best.trial.number,
        "incumbent_objective": best.objective,
        "probability_feasible": best.feasibility,
    }


def _text(values: Mapping[str, object]) -> dict[str, str]:
    return {
        # Plotters read plain numbers only, which repr(np.float64) does not give.
        key: repr(float(value)) if isinstance(value, float) else str(value)
        for key, value in values.items()
        if value is not None
    }
