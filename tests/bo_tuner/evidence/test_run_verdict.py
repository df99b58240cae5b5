"""The verdict on the result of a run, from its validation or from a certificate."""

import dataclasses
import json
from math import isnan

import numpy as np
import pytest
from judged_runs import certify, default_trial, evaluations, made

from bo_tuner.errors import RunRecordError
from bo_tuner.evidence.certificate.findings import Evidence
from bo_tuner.evidence.certificate.making import make_certificate
from bo_tuner.evidence.certificate_file import write_certificate
from bo_tuner.evidence.differences import Change
from bo_tuner.evidence.facts import ApplyWaits, Basis, Contradicted, Drift
from bo_tuner.evidence.quantity import OnRecord
from bo_tuner.evidence.run_verdict import certified, run_verdict
from bo_tuner.evidence.validated import is_default
from bo_tuner.evidence.verdict import FAIL, PASS, State, Status
from bo_tuner.evidence.words.next_steps import next_steps
from bo_tuner.evidence.words.verdict import headline, keeps, sentences
from bo_tuner.study.limits import keeps_limits
from bo_tuner.trials import Stage, WorstCase


def test_apply_is_no_next_step_where_it_refuses(run, monkeypatch):
    certify(run, [(1.0, 0.5)] * 120, [(1.0, 0.5)] * 120, repeated=120)
    with monkeypatch.context() as patch:
        patch.setattr("bo_tuner.evidence.run_verdict.certificate_problem", lambda *_: "")
        commands = [step.command for step in next_steps(run_verdict(run), "run")]
        assert commands[0] == "apply run"
    # 120 draws are fewer than the study asks for.
    verdict = run_verdict(run)
    assert verdict.certificate == PASS
    assert "the study requires" in verdict.remarks[-1].why
    commands = [step.command for step in next_steps(verdict, "run")]
    assert commands[0] == "validate run"
    assert not any(command.startswith("apply") for command in commands)


def test_a_run_that_contradicts_the_study_is_named(run):
    """On every screen that shows the verdict; here by a range that the runs of the study leave."""
    draws = [(1.0, 0.5)] * 20
    sound = made(run, draws, draws, True)
    assert not any(isinstance(fact, Contradicted) for fact in run_verdict(sound).remarks)
    peak = dataclasses.replace(run.study.metrics["peak"], range=(0.9, 5.0))
    study = dataclasses.replace(run.study, metrics={**run.study.metrics, "peak": peak})
    remarks = run_verdict(dataclasses.replace(sound, study=study)).remarks
    (fact,) = (fact for fact in remarks if isinstance(fact, Contradicted))
    assert (fact.how.metric, fact.how.low, fact.how.high) == ("peak", 0.9, 5.0)


def test_a_drift_over_the_validation_is_named(run):
    noise = 0.01 * np.random.default_rng(2).standard_normal(25)
    steady = [(1.0, 0.5 + float(e)) for e in noise]
    warming = [(1.0, 0.5 + float(e) + 0.004 * k) for k, e in enumerate(noise)]
    remarks = run_verdict(made(run, steady, warming, True)).remarks
    (drift,) = (fact for fact in remarks if isinstance(fact, Drift))
    assert (drift.title, drift.whose, drift.in_scatter) == ("peak", "tuned", False)
    assert drift.correlation > 0.0


def test_a_drift_between_the_trials_and_the_validation_is_named(run):
    """The machine has warmed up in between, so neither part drifts by itself."""
    rng = np.random.default_rng(2)
    cold, warm = (
        [(1.0, peak + 0.01 * float(e)) for e in rng.standard_normal(25)] for peak in (0.5, 0.6)
    )
    judged = made(run, warm, warm, True)
    defaults = run.study.search_space().defaults
    others = [e for e in judged.evaluations if e.parameters != defaults or e.trial == 1]
    validated = [e for e in judged.evaluations if e not in others and e.stage is Stage.VALIDATION]
    for of_trial, named in ((warm, []), (cold, [("peak", "default", 35)])):
        trial = evaluations(0, defaults, of_trial[:10], Stage.DRAWN)
        whole = dataclasses.replace(judged, evaluations=(*trial, *others, *validated))
        drifts = [fact for fact in run_verdict(whole).remarks if isinstance(fact, Drift)]
        assert [(drift.title, drift.whose, drift.runs) for drift in drifts] == named
    assert drifts[0].correlation > 0.0


@pytest.mark.parametrize("certificate", [None, "tuned", "both"])
def test_a_better_default_is_preferred(run, certificate):
    """The error is the objective; the peak is lower, and kept by both."""
    draws = [[(error + 0.01 * k, peak - 0.001 * k) for k in range(120)]
             for error, peak in ((1.0, 0.6), (2.0, 0.5))]  # fmt: skip
    run = made(run, *draws, True)
    if certificate:
        certify(run, *draws, with_default=certificate == "both", repeated=120)
    verdict = run_verdict(run)
    assert verdict.feasible
    assert verdict.default_unrefuted
    assert verdict.status is Status.WARNING
    told = "By the objective the default is the better choice"
    if certificate == "both":
        assert f"{told}." in sentences(verdict)
    else:
        assert f"{told}, unless it breaks a limit: validate --with-default checks this." in (
            sentences(verdict)
        )
    commands = [step.command for step in next_steps(verdict, "run")]
    assert not any(command.startswith("apply") for command in commands)
    assert ("validate run --with-default" in commands) == (certificate != "both")


def test_a_worse_objective_is_the_price_of_a_limit_that_holds(tuned):
    run = made(tuned, [(1.0 + 0.01 * k, 1.5) for k in range(8)], [(2.0, 0.5)] * 8, True)
    verdict = run_verdict(run)
    assert not verdict.default_unrefuted
    assert verdict.gained
    # The price is marked.
    assert verdict.status is Status.WARNING
    assert not any("better choice" in sentence for sentence in sentences(verdict))


@pytest.mark.parametrize("stage", [Stage.NOMINAL, Stage.SEARCH])
def test_without_a_search_no_draw_may_exceed_a_worst_case_limit(tuned, stage):
    """On the mean in every context; one of 8 draws exceeds it, for default and tuned alike."""
    trial = tuned.trials[tuned.summary["trial"]]
    draws = [(1.0, 0.5)] * 7 + [(1.0, 1.1)]
    run = made(tuned, draws, draws, True)
    own = [e for e in run.evaluations if dict(e.parameters) == dict(trial.parameters)]
    others = [e for e in run.evaluations if e not in own]
    own = [e if e.stage is Stage.VALIDATION else dataclasses.replace(e, stage=stage) for e in own]
    verdict = run_verdict(dataclasses.replace(run, evaluations=(*others, *own)))
    assert not verdict.default_unrefuted
    assert verdict.feasible == (stage is Stage.SEARCH)
    if stage is Stage.NOMINAL:
        assert verdict.reasons == verdict.default_reasons


@pytest.mark.parametrize(("worst", "keeps"), [(None, False), (0.9, True), (1.1, False)])
def test_a_default_whose_worst_context_was_searched_counts_as_such(tuned, worst, keeps):
    """One of 8 draws exceeds a limit on the mean in every context, as it may."""
    draws = [(1.0, 0.5)] * 7 + [(1.0, 1.1)]
    run = made(tuned, draws, [(1.0, 0.5)] * 8, True)
    if worst is not None:
        trial = default_trial(run)
        found = WorstCase(worst, {"load": 2.0}, worst, 0.01)
        trials = list(run.trials)
        trials[trial.number] = dataclasses.replace(trial, worst_cases={"peak": found})
        searched = evaluations(trial.number, trial.parameters, [(1.0, worst)], Stage.SEARCH)
        run = dataclasses.replace(
            run, trials=tuple(trials), evaluations=(*run.evaluations, *searched)
        )
    verdict = run_verdict(run)
    assert verdict.default_unrefuted is keeps
    if worst == 1.1:
        trial = default_trial(run).number
        (reason,) = verdict.default_reasons
        assert (reason.title, reason.value, reason.trial) == ("peak", 1.1, trial)
    if worst is None:
        assert verdict.default_reasons[0].limit.unsearched


def test_a_result_that_is_the_default_is_judged_as_the_default(tuned):
    trial = default_trial(tuned).number
    run = dataclasses.replace(tuned, summary=dict(tuned.summary) | {"trial": trial})
    for passed_check in (True, False):
        draws = [(1.0, 0.5)] * 8
        verdict = run_verdict(made(run, draws, draws, passed_check))
        assert verdict.is_default
        assert verdict.reasons == verdict.default_reasons
        assert keeps(verdict) == ("not proven", "not proven")


def test_a_feasible_default_beside_an_infeasible_result_is_not_kept_quiet(tuned):
    verdict = run_verdict(made(tuned, [(1.0, 0.5)] * 8, [(1.0, 1.5)] * 8, True))
    assert headline(verdict) == (
        "The tuned parameter set is not feasible; nothing refutes the default: "
        "trials kept all limits in their own runs, but fresh test runs broke the limit of peak"
    )
    told = "The default by the same evidence: no limit broken in 8 test runs."
    assert told in sentences(verdict)


def another_trial(run):
    """A trial that is neither the result nor the default."""
    others = {run.summary["trial"], default_trial(run).number}
    return next(t for t in run.trials if t.number not in others and t.worst_cases)


def test_a_certificate_of_another_trial_is_not_one_of_the_result(run):
    """It knows of the default what the validation found, and its next steps name the trial."""
    draws = [(1.0, 0.5)] * 120
    run = made(run, draws, [(1.0, 0.9)] * 120, True)
    other = another_trial(run)
    made_of = dataclasses.replace(run, summary=dict(run.summary) | {"trial": other.number})
    certify(made_of, draws, draws, with_default=False, repeated=120)
    verdict = certified(run, other, run.path / "certificates" / "0001.json")
    assert verdict.certificate == PASS
    assert not verdict.is_result
    assert keeps(verdict) == ("not proven", "yes")
    assert verdict.basis == Basis(120, paired=False, validation=120)
    # The draws of the validation are of another parameter set, so there are no pairs.
    assert all(q.change is Change.UNKNOWN for q in verdict.quantities)
    number = other.number
    refused = [step.command for step in next_steps(verdict, "run")]
    assert refused == [f"validate run --trial {number}", f"replay run --trial {number}"]
    opened = dataclasses.replace(verdict, apply_refuses=False)
    commands = [step.command for step in next_steps(opened, "run")]
    assert commands[0] == f"apply run --trial {number}"
    failed = dataclasses.replace(verdict, state=State.REFUSED, is_result=True)
    assert [step.command for step in next_steps(failed, "run")] == [
        "validate run --until-pass 3",
        "tune --resume run --trials N",
        "replay run",
    ]
    assert run_verdict(run).certificate == ""


def test_apply_waits_for_the_result_of_a_run_that_has_none(run, monkeypatch):
    monkeypatch.setattr("bo_tuner.evidence.run_verdict.certificate_problem", lambda *_: "")
    draws = [(1.0, 0.5)] * 120
    certify(run, draws, draws, with_default=False, repeated=120)
    trial = run.trials[run.summary["trial"]]
    going_on = dataclasses.replace(run, summary=None)
    verdict = certified(going_on, trial, run.path / "certificates" / "0001.json")
    assert verdict.certificate == PASS
    commands = [step.command for step in next_steps(verdict, "run")]
    assert commands == ["tune --resume run", f"replay run --trial {trial.number}"]
    assert ApplyWaits() in verdict.remarks


def test_draws_of_a_certificate_and_of_a_validation_are_not_mixed(run):
    """A draw of the validation beyond the limit counts as on record, and once."""
    draws = [(1.0, 0.5)] * 24
    run = made(run, [*draws, (1.0, 0.5)], [*draws, (1.0, 1.4)], True)
    trial = run.trials[run.summary["trial"]]
    known = sum(
        dict(e.parameters) == dict(trial.parameters) and e.outcome.complete for e in run.evaluations
    )
    found = certify(run, draws, [(1.2, 0.6)] * 120, with_default=False, repeated=120)
    verdict = run_verdict(run)
    (worst,) = [q for q in verdict.quantities if q.metric == "peak" and q.limit_verdict is not None]
    (error,) = [q for q in verdict.quantities if q.label == "mean error"]
    assert worst.on_record == OnRecord(known + found.tuned.evaluations, 1.4)
    # Both columns are of the draws that both have, those of the validation.
    assert (error.default, error.tuned, error.difference.mean) == pytest.approx((1.0, 1.0, 0.0))
    assert verdict.observed[1].values("peak") == [0.6] * 120


def test_a_limit_on_single_runs_names_what_decides(run_of_single_runs):
    """None of 120 draws is beyond the limit, but 30 of 120 runs in the worst context are."""
    run, values = run_of_single_runs, [(1.0, 0.7)] * 120
    run = made(run, values, values, True)
    trial = run.trials[run.summary["trial"]]
    there = [(1.0, 0.7) if k % 4 else (1.0, 1.05) for k in range(120)]
    worst = evaluations(1, trial.parameters, there, Stage.CHECK_WORST)
    evidence = {
        "tuned": Evidence(
            trial.parameters, evaluations(1, trial.parameters, values), repeated=(worst,)
        )
    }
    found = make_certificate(run, trial, evidence, 120, 0.95, 1, "inprocess", None)
    write_certificate(run.path, run.study, found, evidence)
    (quantity,) = [q for q in run_verdict(run).quantities if q.limit_verdict is not None]
    bound = found.tuned.constraints[0].worst[0].violation_bound
    assert (quantity.violation.worst, quantity.violation.allowed) == pytest.approx((bound, 0.15))
    assert isnan(quantity.bound)


def test_what_a_device_holds_in_fewer_digits_is_named(run):
    """Of the parameter set that was judged, and of nothing that changes from run to run."""
    trial = run.trials[run.summary["trial"]]
    name, item = next((n, i) for n, i in run.study.parameters.items() if i.is_tuned)
    told = trial.parameters[name]
    held = float(np.float32(told))
    noted = {f"{item.node}.{item.parameter}": held, "axis.load": 0.125}
    drawn = tuple(
        dataclasses.replace(e, outcome=e.outcome.noted(held=noted))
        for e in evaluations(1, trial.parameters, [(1.0, 0.7)] * 120)
    )
    evidence = {"tuned": Evidence(trial.parameters, drawn)}
    found = make_certificate(run, trial, evidence, 120, 0.95, 1, "ros", None)
    content = json.loads(write_certificate(run.path, run.study, found, evidence).read_text())
    assert held != told
    assert content["held"] == {name: held}
    warning = f"{name}: the device holds {held}, in 32 bits, of the {told} that it is told"
    assert warning in content["warnings"]


@pytest.fixture
def run_of_single_runs(run):
    constraint = dataclasses.replace(run.study.constraints["peak"], probability=0.85)
    study = dataclasses.replace(run.study, constraints={"peak": constraint})
    return dataclasses.replace(run, study=study)


def test_attempts_with_another_confidence_have_the_lowest_one_together(run):
    draws = [(1.0, 0.5)] * 120
    certify(run, draws, draws)
    certify(run, draws, draws)
    first = run.path / "certificates" / "0001.json"
    first.write_text(json.dumps(json.loads(first.read_text()) | {"confidence": 0.5}))
    assert run_verdict(run).remarks[0].together == 0.5


def test_the_largest_value_on_record_is_not_hidden(tuned):
    """A peak of 0.99 in the tuning is named beside the 0.5 of a validation."""
    trial = tuned.trials[tuned.summary["trial"]]
    run = made(tuned, [(1.0, 0.5)] * 5, [(1.0, 0.5)] * 5, True)
    seen = evaluations(trial.number, trial.parameters, [(1.0, 0.99)], Stage.SEARCH)
    verdict = run_verdict(dataclasses.replace(run, evaluations=(*run.evaluations, *seen)))
    (peak,) = [q for q in verdict.quantities if q.label == "largest peak"]
    assert peak.tuned == 0.5
    assert peak.on_record.value == 0.99
    assert "gained nothing" in sentences(verdict)[-1]


def test_a_result_that_is_the_default_is_said_to_be_it(tuned):
    verdict = run_verdict(made(tuned, [(1.0, 0.5)] * 5, [(1.0, 0.5)] * 5, True))
    says = "The tuned parameter set is the default: no other was found to be better."
    assert not verdict.is_default
    assert says not in sentences(verdict)
    same = dataclasses.replace(verdict, is_default=True)
    assert sentences(same)[-1] == says
    assert not any(
        sentence.startswith(("Better", "Worse", "Lower")) for sentence in sentences(same)
    )
    assert not same.gained
    assert not same.default_preferred
    assert is_default(tuned.study, tuned.study.search_space().defaults)


@pytest.mark.parametrize("text", ["", "parameter_set,stage\ntuned,none\n", "\x00", None])
def test_a_verdict_survives_evaluations_that_cannot_be_read(run, text):
    certify(run, [(1.0, 0.5)] * 3, [(1.0, 2.0)] * 3)
    path = run.path / "certificates" / "0001_evaluations.csv"
    path.unlink() if text is None else path.write_text(text)
    verdict = run_verdict(run)
    assert verdict.certificate == FAIL
    assert verdict.reasons[0].found.name == "peak"


def test_a_trial_within_the_limits_that_was_not_ranked_is_told_of(tuned):
    run = made(tuned, [(1.0, 0.5)] * 8, [(1.0, 1.5)] * 8, False)
    within = [t.number for t in run.trials if keeps_limits(run.study, t)]
    ranked = [t.number for t in run.trials if t.number != within[0]]
    summary = dict(run.summary) | {"ranked_trials": ranked}
    found = run_verdict(dataclasses.replace(run, summary=summary))
    assert found.outliers == (within[0],)
    assert any(f"Trial {within[0]} broke no limit" in text for text in sentences(found))
    for known in ([*ranked, within[0]], None):
        everyone = dataclasses.replace(run, summary=summary | {"ranked_trials": known})
        assert run_verdict(everyone).outliers == ()


def test_better_parameter_sets_that_were_passed_over_are_named(tuned):
    run = made(tuned, [(1.0, 0.5)] * 8, [(1.0, 0.5)] * 8, True)
    item = {"trial": 3, "objective": 0.75, "feasibility": 0.81, "shown": False}
    shown = {"trial": 2, "objective": 0.5, "feasibility": 0.98, "shown": True}

    def said(*found):
        summary = dict(run.summary) | {"passed_over": list(found)}
        return sentences(run_verdict(dataclasses.replace(run, summary=summary)))

    assert said()[-1] != said(item)[-1]
    assert said(item)[:-1] == said()
    name = run.study.objective.metric
    unit = f" {run.study.metrics[name].unit}".rstrip()
    assert said(shown, item)[-1] == (
        f"Better by the model, but passed over: trial 2 ({name} 0.5{unit}, 98 % likely within "
        "limits, no runs were left to confirm it), "
        f"trial 3 ({name} 0.75{unit}, 81 % likely within limits, too little). "
        "validate --trial N tests one of them."
    )
    assert ", and 2 more. validate" in said(*[item] * 5)[-1]


@pytest.mark.parametrize("found", [3, [3], [{"trial": 1}], [{"trial": "x", "objective": None}]])
def test_a_summary_with_something_else_passed_over_is_refused(tuned, found):
    run = made(tuned, [(1.0, 0.5)] * 8, [(1.0, 0.5)] * 8, True)
    summary = dict(run.summary) | {"passed_over": found}
    with pytest.raises(RunRecordError, match="its summary is not one of tune's"):
        run_verdict(dataclasses.replace(run, summary=summary))


def test_a_repetition_is_no_outlier(tuned):
    """Its evaluations count as those of the first trial of the parameter set, which is ranked."""
    run = made(tuned, [(1.0, 0.5)] * 8, [(1.0, 1.5)] * 8, True)
    within = next(t for t in run.trials if keeps_limits(run.study, t))
    again = dataclasses.replace(within, number=len(run.trials))
    run = dataclasses.replace(run, trials=(*run.trials, again))
    assert again.number not in run.summary["ranked_trials"]
    assert run_verdict(run).outliers == ()
