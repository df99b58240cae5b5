"""A run with other draws in the validation of its result, or in a certificate of it."""

import dataclasses

from bo_tuner.codec.writing import to_json
from bo_tuner.evidence.certificate.findings import Evidence
from bo_tuner.evidence.certificate.making import make_certificate
from bo_tuner.evidence.certificate_file import write_certificate
from bo_tuner.study.limits import judge_samples
from bo_tuner.trials import SEEKING_WORST, Evaluation, EvaluationState, Outcome, Stage
from bo_tuner.tuning.validation import Validation


def evaluations(side, parameters, values, stage=Stage.VALIDATION):
    """Evaluations of trial `side` with error and peak of each; one that failed for each None."""
    outcomes = [
        Outcome(EvaluationState.FAILED, reason="stalled")
        if value is None
        else Outcome(EvaluationState.COMPLETE, {"error": value[0], "peak": value[1]})
        for value in values
    ]
    return tuple(
        Evaluation(side, k, stage, parameters, {"load": 1.5}, k, outcome)
        for k, outcome in enumerate(outcomes)
    )


def validation(study, found):
    complete = [e for e in found if e.outcome.metrics]
    return Validation(
        parameters=found[0].parameters,
        draws=len(found),
        failures=len(found) - len(complete),
        lost=0,
        constraints=judge_samples(study, found),
    )


def made(run, default, tuned, passed_check):
    """The run with another validation of its result, and without a search for the default."""
    study, trial = run.study, run.trials[run.summary["trial"]]
    defaults = study.search_space().defaults
    sides = [evaluations(0, defaults, default), evaluations(1, trial.parameters, tuned)]
    earlier = [
        e
        for e in run.evaluations
        if e.stage is not Stage.VALIDATION
        and not (e.stage in SEEKING_WORST and dict(e.parameters) == defaults)
    ]
    trials = tuple(
        dataclasses.replace(t, worst_cases={}) if dict(t.parameters) == defaults else t
        for t in run.trials
    )
    found = [validation(study, side) for side in sides]
    summary = dict(run.summary) | {
        "feasible": passed_check and found[1].feasible,
        "passed_check": passed_check,
        **{name: to_json(item) for name, item in zip(("default", "tuned"), found, strict=True)},
    }
    return dataclasses.replace(
        run, summary=summary, trials=trials, evaluations=(*earlier, *sides[0], *sides[1])
    )


def certify(run, default, tuned, *, with_default=True, repeated=2):
    """Certify the result by these draws, the first `repeated` ones also as of the worst context."""
    trial = run.trials[run.summary["trial"]]
    evidence = {}
    for side, (name, parameters, values) in enumerate(
        [
            ("default", run.study.search_space().defaults, default),
            ("tuned", trial.parameters, tuned),
        ]
    ):
        of_worst = evaluations(
            side, parameters, [v for v in values if v][:repeated], Stage.CHECK_WORST
        )
        evidence[name] = Evidence(
            parameters,
            evaluations(side, parameters, values),
            repeated=(of_worst,) if of_worst else (),
        )
    if not with_default:
        del evidence["default"]
    certificate = make_certificate(run, trial, evidence, len(tuned), 0.95, 1, "inprocess", None)
    write_certificate(run.path, run.study, certificate, evidence)
    return certificate


def default_trial(run):
    """The trial of the parameters' defaults."""
    defaults = run.study.search_space().defaults
    return next(trial for trial in run.trials if dict(trial.parameters) == defaults)
