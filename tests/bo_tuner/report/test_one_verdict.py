"""Terminal, page, bundle, summary, topics and exit code say the same of any run."""

import dataclasses
import io
import json
import re
import shutil
from html import unescape
from math import isfinite

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from rich.console import Console

from bo_tuner.certificate.certificate import make_certificate, write_certificate
from bo_tuner.certificate.evidence import Evidence
from bo_tuner.certificate.run_verdict import run_verdict
from bo_tuner.cli.deliverables import write_deliverables
from bo_tuner.cli.exit_codes import EXIT_INFEASIBLE, EXIT_OK, exit_code
from bo_tuner.monitoring.diagnostics import progress
from bo_tuner.monitoring.status import Snapshot
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.page import render
from bo_tuner.storage.record import read_run
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage
from bo_tuner.tuning.limits import judge_samples
from bo_tuner.tuning.validation import Validation
from bo_tuner.verdict.next_steps import next_steps
from bo_tuner.verdict.table import print_verdict
from bo_tuner.verdict.verdict import FAIL, PASS, State

draws = st.lists(
    st.none() | st.tuples(st.floats(0.5, 2.0), st.floats(0.2, 1.05)), min_size=2, max_size=8
)
"""Error and peak of each draw, whose limit is 1; None for a failed one."""


def evaluations(side, parameters, values, stage=Stage.VALIDATION):
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
    complete = [e.outcome.metrics["error"] for e in found if e.outcome.metrics]
    return Validation(
        parameters=found[0].parameters,
        draws=len(found),
        failures=len(found) - len(complete),
        objective=sum(complete) / len(complete) if complete else float("nan"),
        deviation=float("nan"),
        constraints=judge_samples(study, found),
    )


def made(run, default, tuned, passed_check):
    """The run with another validation of its result."""
    study, trial = run.study, run.trials[run.summary["trial"]]
    sides = [
        evaluations(0, study.search_space().defaults, default),
        evaluations(1, trial.parameters, tuned),
    ]
    earlier = [e for e in run.evaluations if e.stage is not Stage.VALIDATION]
    found = [validation(study, side) for side in sides]
    summary = dict(run.summary) | {
        "feasible": passed_check and found[1].feasible,
        "passed_check": passed_check,
        **{
            name: dataclasses.asdict(item) | {"feasible": item.feasible}
            for name, item in zip(("default", "tuned"), found, strict=True)
        },
    }
    return dataclasses.replace(run, summary=summary, evaluations=(*earlier, *sides[0], *sides[1]))


def certify(run, default, tuned, *, with_default=True):
    trial = run.trials[run.summary["trial"]]
    evidence = {}
    for side, (name, parameters, values) in enumerate(
        [
            ("default", run.study.search_space().defaults, default),
            ("tuned", trial.parameters, tuned),
        ]
    ):
        of_worst = evaluations(side, parameters, [v for v in values if v][:2], Stage.CHECK_WORST)
        evidence[name] = Evidence(
            parameters,
            evaluations(side, parameters, values),
            repeated=(of_worst,) if of_worst else (),
        )
    if not with_default:
        del evidence["default"]
    certificate = make_certificate(run, trial, evidence, len(tuned), 0.95, 1, "inprocess", None)
    write_certificate(run.path, certificate, evidence)
    return certificate


def on_terminal(run, verdict):
    out = Console(file=io.StringIO(), width=300)
    tuned = run.trials[run.summary["trial"]].parameters
    print_verdict(out, run.study, verdict, tuned)
    return out.file.getvalue()


def on_page(run):
    analysis = Analysis(run)
    found = analysis.certificate
    return render(analysis, [] if found is None else [found.section])


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("verdicts")


@settings(
    max_examples=20,
    deadline=None,
    suppress_health_check=list(HealthCheck),
    # An example takes a second: to shrink one would take minutes.
    phases=(Phase.explicit, Phase.reuse, Phase.generate),
)
@given(
    default=draws,
    tuned=draws,
    passed_check=st.booleans(),
    certified=st.none() | st.tuples(draws, draws),
)
def test_every_screen_says_the_same(tuned_run, folder, default, tuned, passed_check, certified):
    shutil.rmtree(folder / "certificates", ignore_errors=True)
    count = min(len(default), len(tuned))
    run = made(tuned_run(), default[:count], tuned[:count], passed_check)
    run = dataclasses.replace(run, path=folder)
    certificate = None
    if certified is not None:
        count = min(map(len, certified))
        certificate = certify(run, *(values[:count] for values in certified))
    verdict = run_verdict(run)

    # What it says is what was found.
    if certificate is not None:
        assert verdict.feasible == certificate.passed == (verdict.certificate == PASS)
        assert verdict.default_keeps == certificate.default.passed
    else:
        found = Validation.from_mapping(run.summary["tuned"])
        assert verdict.feasible == (passed_check and found.feasible)
        assert verdict.state is not State.CERTIFIED

    keeps = {True: "yes", False: "no"}
    both = [keeps[verdict.default_keeps], keeps[verdict.feasible]]

    terminal = on_terminal(run, verdict)
    assert terminal.splitlines()[0] == verdict.headline
    (row,) = [line for line in terminal.splitlines() if line.startswith("keeps all limits")]
    assert row.lower().split()[3:] == both
    assert not re.search(r"\b(nan|inf)\b", terminal)

    page = on_page(run)
    (title,) = re.findall(r'<h2 id="answer-title">(.*?)</h2>', page)
    assert unescape(title) == verdict.headline
    (mark,) = re.findall(r'<section id="answer" class="answer (\w+)"', page)
    assert (mark == "bad") == (not verdict.feasible)
    (row,) = re.findall(r"keeps all limits</th>(.*?)</tr>", page, re.DOTALL)
    assert re.findall(r"<td[^>]*>(yes|no)</td>", row) == both
    shown = set(re.findall(rf">\s*({PASS}|{FAIL})\s", page))
    assert shown <= {verdict.certificate}
    for sentence in verdict.sentences:
        assert sentence in terminal
        assert sentence in unescape(page)

    mapping = json.loads(json.dumps(verdict.to_mapping(), allow_nan=False))
    assert mapping["headline"] == verdict.headline
    assert mapping["keeps_limits"] == {
        "default": verdict.default_keeps,
        "tuned": verdict.feasible,
    }
    topic = progress(run.study, Snapshot(verdict=verdict))
    assert topic.message == verdict.headline
    assert topic.values["feasible"] == str(verdict.feasible)
    assert exit_code(verdict) == (EXIT_OK if verdict.feasible else EXIT_INFEASIBLE)


@pytest.fixture(scope="session")
def tuned_run(tuned):
    """Function that returns the run, whose text would be too long for a failing example."""
    return lambda: tuned


@pytest.mark.parametrize("peak", [0.5, 2.0])
def test_a_certificate_brings_summary_and_bundle_up_to_date(tuned, tmp_path, peak):
    shutil.copytree(tuned.path, tmp_path / "run")
    run = read_run(tmp_path / "run")
    before = json.loads((run.path / "summary.json").read_text())
    tuned_draws = [(1.0 + 0.01 * k, peak + 0.001 * k) for k in range(40)]
    certificate = certify(run, [(1.0, 0.5)] * 40, tuned_draws)
    write_deliverables(run.path, lambda text: None, pytest.fail)
    verdict = run_verdict(read_run(run.path))
    assert verdict.certificate == (PASS if certificate.passed else FAIL)
    after = json.loads((run.path / "summary.json").read_text())
    bundle = json.loads((run.path / "deploy" / "provenance.json").read_text())
    assert after["verdict"] == bundle["verdict"] == verdict.to_mapping()
    assert after["feasible"] == verdict.feasible
    assert {k: v for k, v in after.items() if k not in ("verdict", "feasible")} == {
        k: v for k, v in before.items() if k not in ("verdict", "feasible")
    }


@pytest.mark.parametrize("with_default", [True, False])
def test_each_number_tells_its_draws_where_they_differ(tuned, tmp_path, with_default):
    """5 draws of the validation for both, 40 more of the certificate for the tuned one alone."""
    shutil.copytree(tuned.path, tmp_path / "run")
    run = read_run(tmp_path / "run")
    certify(run, [(2.0, 0.5)] * 40, [(1.0, 0.5)] * 40, with_default=with_default)
    verdict = run_verdict(run)
    (error,) = [q for q in verdict.quantities if q.label == "mean error"]
    assert error.difference.count == (40 if with_default else 5)
    told = "" if with_default else "default in 5 draws, tuned in 45, difference in the 5 of both"
    assert error.draws == told
    lines = on_terminal(run, verdict).splitlines()
    assert any(line.endswith(f": {told}") for line in lines if told) is not with_default
    assert (told in on_page(run)) if told else ("tuned in" not in on_page(run))
    assert verdict.evidence == (
        "the same 40 fresh draws of context and noise"
        if with_default
        else "40 fresh draws of context and noise and the 5 draws of the validation, which alone "
        "have the default"
    )
    assert verdict.remarks[0] == (
        "Each bound has 97.5 % confidence, so that all attempts to certify this run have 95 % "
        "together."
    )
    # What the limit is on, also where only the tuned parameter set was searched for it.
    (worst,) = [q for q in verdict.quantities if q.metric == "peak" and q.holds is not None]
    assert worst.label == "worst-case peak"
    assert worst.tuned == 0.5
    assert isfinite(worst.default) is with_default
    assert ("was not searched" in worst.remark) is not with_default


def test_apply_is_no_next_step_where_it_refuses(tuned, tmp_path, monkeypatch):
    shutil.copytree(tuned.path, tmp_path / "run")
    run = read_run(tmp_path / "run")
    certify(run, [(1.0, 0.5)] * 40, [(1.0, 0.5)] * 40)
    path = run.path / "certificates" / "0001.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"verdict": PASS}))
    with monkeypatch.context() as patch:
        patch.setattr("bo_tuner.certificate.run_verdict.certificate_problem", lambda *_: "")
        commands = [step.command for step in next_steps(run_verdict(run), "run")]
        assert commands[0] == "apply run"
    # 40 draws are fewer than the study asks for.
    verdict = run_verdict(run)
    assert verdict.certificate == PASS
    assert "the study requires" in verdict.remarks[-1]
    commands = [step.command for step in next_steps(verdict, "run")]
    assert commands[0] == "validate run"
    assert not any(command.startswith("apply") for command in commands)


def test_the_largest_value_on_record_is_not_hidden(tuned):
    """A peak of 0.99 in the tuning is named beside the 0.5 of a validation."""
    trial = tuned.trials[tuned.summary["trial"]]
    run = made(tuned, [(1.0, 0.5)] * 5, [(1.0, 0.5)] * 5, True)
    seen = evaluations(trial.number, trial.parameters, [(1.0, 0.99)], Stage.SEARCH)
    verdict = run_verdict(dataclasses.replace(run, evaluations=(*run.evaluations, *seen)))
    (peak,) = [q for q in verdict.quantities if q.label == "largest peak"]
    assert peak.tuned == 0.5
    assert "on record 0.99" in peak.remark
    assert "gained nothing" in verdict.sentences[-1]


def test_the_links_of_the_report_lead_into_the_run_from_the_bundle_as_well(tuned, tmp_path):
    shutil.copytree(tuned.path, tmp_path / "run")
    write_deliverables(tmp_path / "run", lambda text: None, pytest.fail)
    for page, up in (("report.html", "."), ("deploy/report.html", "..")):
        text = (tmp_path / "run" / page).read_text(encoding="utf-8")
        links = re.findall(r'<a href="(\.[^"#]+)"', text)
        assert f"{up}/best.yaml" in links
        for link in links:
            assert (tmp_path / "run" / page).parent.joinpath(link).exists()


@pytest.mark.parametrize("text", ["", "parameter_set,stage\ntuned,none\n", "\x00", None])
def test_a_verdict_survives_evaluations_that_cannot_be_read(tuned, tmp_path, text):
    shutil.copytree(tuned.path, tmp_path / "run")
    run = read_run(tmp_path / "run")
    certify(run, [(1.0, 0.5)] * 3, [(1.0, 2.0)] * 3)
    path = run.path / "certificates" / "0001_evaluations.csv"
    path.unlink() if text is None else path.write_text(text)
    verdict = run_verdict(run)
    assert verdict.certificate == FAIL
    assert verdict.reasons[0].startswith("peak: ")
