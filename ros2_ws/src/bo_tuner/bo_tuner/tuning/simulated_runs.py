"""Trials of a simulation that a run on the machine begins with as prior knowledge.

They are no trials of the run: they have a file of their own in its folder, which is a journal, and
the method has them as a `bo_tuner.models.simulation.Simulation` in its models.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

from bo_tuner.errors import RunRecordError
from bo_tuner.methods.protocol import Method
from bo_tuner.storage.journal import create_journal
from bo_tuner.storage.record import RunRecord
from bo_tuner.storage.run_folder import SIMULATION
from bo_tuner.study.study import Study
from bo_tuner.trials import (
    ESTIMATING,
    Evaluation,
    Outcome,
    Trial,
    TrialState,
    Value,
    WorstCase,
)
from bo_tuner.tuning.carrying import Carried, LeftOutError, Taking


def take_simulation(record: RunRecord, study: Study, method: Method) -> Carried:
    """Take the trials of a simulation as prior knowledge of the machine of a study.

    What the two have in common is parameters, contexts and metrics of the same names: nodes, runs
    and how a metric is measured may differ. The machine may lack contexts, which nobody can set
    there; then test runs in a context that was drawn or is nominal are data, and what the context
    changes counts as noise. Those in contexts that were searched for are none.
    """
    then = record.study
    metrics = dict.fromkeys(
        (
            *(objective.metric for objective in study.objectives),
            *(constraint.metric for constraint in study.constraints.values()),
            *study.measured,
            *study.logarithmic_metrics,
        )
    )
    for kind, needed, known in (
        ("parameter", study.parameters, then.parameters),
        ("context", study.contexts, then.contexts),
        ("metric", metrics, then.metrics),
    ):
        for name in needed:
            if name not in known:
                raise RunRecordError(
                    f"{record.path}: is no simulation of {study.name}: it has no {kind} '{name}'"
                )
    for name in metrics:
        units = [each.metrics[name].unit for each in (then, study)]
        if units[0] != units[1]:
            raise RunRecordError(
                f"{record.path}: is no simulation of {study.name}: metric '{name}' is in "
                f"{units[0] or 'no unit'} there, in {units[1] or 'no unit'} here"
            )
    taking = _Taking(record, study, method, None, str(record.path.resolve()))
    taken = list(taking.trials())
    if not any(trial.state is TrialState.COMPLETE for trial in taken):
        why = taking.left_out or "all have failed"
        raise RunRecordError(f"{record.path}: none of its trials can be used: {why}")
    text = taking.summary(taken)
    if _best(study, record, taken) is None:
        text += "; no result that this machine may begin with"
    return Carried(taking.run, tuple(taken), text)


def begun_by_simulation(study: Study, record: RunRecord, known: Carried) -> Study:
    """Return the study of a machine whose initial design the simulation stands in for.

    It begins with its own start, and then, if there are more trials, with the result of the
    simulation.
    """
    best = _best(study, record, known.trials)
    is_last = len(study.starting_sets()) >= study.budget.trials
    begun = study.replace(start=[] if best is None or is_last else [best])
    return begun.replace(initial_trials=len(begun.starting_sets()) or 1)


def _best(study: Study, record: RunRecord, taken: Sequence[Trial]) -> Mapping[str, Value] | None:
    """Return the result of the simulation if it is among what was taken of it."""
    if record.result is None:
        return None
    best = {name: record.result.parameters[name] for name in study.search_space().names}
    is_taken = any(best.items() <= trial.parameters.items() for trial in taken)
    return best if is_taken else None


def write_simulation(folder: Path, known: Carried) -> None:
    """Write what a run knows of a simulation into its folder."""
    create_journal(folder / SIMULATION, [], known.content.evaluations, known.trials)


class _Taking(Taking):
    """Goes through the trials of a simulation, whose metrics it takes by their names."""

    def _evaluation(self, evaluation: Evaluation) -> Evaluation:
        gone = self._then.contexts.keys() - self._study.contexts.keys()
        if gone and evaluation.stage not in ESTIMATING:
            raise LeftOutError("in a context that was searched for")
        taken = super()._evaluation(evaluation)
        context = {name: taken.context[name] for name in self._study.contexts}
        return dataclasses.replace(taken, context=context)

    def _outcome(self, evaluation: Evaluation) -> Outcome:
        outcome = evaluation.outcome
        if outcome.was_cut_short:
            raise LeftOutError("cut short")
        if not outcome.complete:
            return outcome
        metrics = {n: value for n, value in outcome.metrics.items() if n in self._study.metrics}
        return dataclasses.replace(outcome, metrics=metrics)

    def _worst_cases(self, trial: Trial) -> dict[str, WorstCase]:
        return {}
