"""Fresh runs beside those of a certificate."""

import json

import numpy as np
import pytest
from functions import FunctionBackend, failed, make_study
from made_runs import INITIAL, make_run, write_certificate

from bo_tuner.errors import RunError, RunRecordError
from bo_tuner.evidence.certificate.store import read_certificate
from bo_tuner.evidence.drift import DriftPlan, baseline_runs, next_number_of, result_of
from bo_tuner.trials import EvaluationState, Outcome
from bo_tuner.tuning.driver import Driver

STUDY = make_study(contexts={})
PARAMETERS = {"gain": 0.4}


def complete(error, peak):
    return Outcome(EvaluationState.COMPLETE, {"error": error, "peak": peak})


def baseline(count=40):
    rng = np.random.default_rng(1)
    return [complete(*row) for row in rng.normal(size=(count, 2))]


def plan_of(most=20, number=1, study=STUDY):
    return DriftPlan(study, PARAMETERS, baseline(), ["error", "peak"], most, 0.05, number)


def runs(plan, function, study=STUDY):
    Driver(FunctionBackend(study, function)).complete(plan)
    return plan


def metrics(gain, seed, shift=0.0):
    error, peak = np.random.default_rng(seed).normal(size=2)
    return {"error": error, "peak": peak + shift}


def test_a_machine_as_before():
    plan = runs(plan_of(), metrics)
    assert plan.found_after == {"error": None, "peak": None}
    assert len(plan.evaluations) == 20
    assert {tuple(run.parameters.items()) for run in plan.evaluations} == {(("gain", 0.4),)}
    error, _ = plan.compared
    assert error.baseline == np.median([outcome.metrics["error"] for outcome in baseline()])
    assert error.fresh == np.median([run.outcome.metrics["error"] for run in plan.evaluations])


def test_a_metric_that_has_drifted_ends_it():
    plan = runs(plan_of(), lambda gain, seed: metrics(gain, seed, shift=-5.0))
    assert plan.found_after["error"] is None
    assert plan.found_after["peak"] == len(plan.evaluations) < 15


def test_runs_that_fail_are_a_drift_of_every_metric():
    plan = runs(plan_of(), lambda **_: failed("stalled"))
    assert plan.found_after["error"] == plan.found_after["peak"] == len(plan.evaluations)
    assert all(item.fresh == np.inf for item in plan.compared)


def test_a_run_that_is_lost_is_run_again_and_does_not_count():
    calls = []

    def sometimes(gain, seed):
        calls.append(seed)
        lost = len(calls) in (3, 6, 7)
        return failed("gone", EvaluationState.LOST) if lost else metrics(gain, seed)

    plan = runs(plan_of(), sometimes)
    # The third was repeated in vain once: it is left out; the other at its second attempt.
    assert len(calls) == 22
    assert len(plan.evaluations) == 19
    assert calls[2] == calls[3]


def test_each_comparison_has_noise_and_contexts_of_its_own():
    study = make_study()

    def loaded(gain, load, seed):
        return metrics(gain, seed)

    first, again, second = (
        runs(plan_of(5, number, study), loaded, study).evaluations for number in (1, 1, 2)
    )
    assert [(r.seed, r.context) for r in first] == [(r.seed, r.context) for r in again]
    assert not {r.seed for r in first} & {r.seed for r in second}
    assert first[0].context != second[0].context


@pytest.fixture
def record(tmp_path):
    study = make_study(contexts={}, budget=INITIAL)
    return make_run(tmp_path / "run", study, FunctionBackend(study, metrics), result=0)


def test_a_certificate_without_baseline_runs(record):
    path = write_certificate(record, record.trials[0])
    certificate = read_certificate(path, record.study)
    with pytest.raises(RunRecordError, match="has 0 complete baseline runs; expected at least 10"):
        baseline_runs(path, certificate, record.study)
    evaluations = path.with_name("0001_evaluations.csv")
    evaluations.write_text("other")
    with pytest.raises(RunRecordError, match=r"has no baseline runs: .* does not match its digest"):
        baseline_runs(path, certificate, record.study)
    evaluations.unlink()
    with pytest.raises(RunRecordError, match=r"has no baseline runs: .* cannot be read"):
        baseline_runs(path, certificate, record.study)


def test_a_certificate_of_another_study(record):
    other = make_study(contexts={}, budget=INITIAL, seed=9)
    path = write_certificate(record, record.trials[0])
    with pytest.raises(RunRecordError, match="belongs to another version of the study"):
        baseline_runs(path, read_certificate(path, other), other)


def test_no_usable_run():
    plan = plan_of(1)
    runs(plan, lambda **_: failed("gone", EvaluationState.LOST))
    with pytest.raises(RunError, match="no fresh run was usable"):
        result_of(plan, "0001.json", "", "")


def test_the_number_of_the_next(tmp_path):
    assert next_number_of(tmp_path) == 1
    (tmp_path / "drift").mkdir()
    for name in ("0007.json", "note.txt", ".0008.json.3.new"):
        (tmp_path / "drift" / name).write_text(json.dumps({}))
    assert next_number_of(tmp_path) == 8
