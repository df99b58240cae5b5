"""Terminal, page, bundle, summary, topics and exit code say the same of any run."""

import contextlib
import dataclasses
import io
import json
import re
import shutil
from html import unescape
from math import isfinite
from types import SimpleNamespace

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from judged_runs import certify, default_trial, made
from rich.console import Console

from bo_tuner.cli import apply
from bo_tuner.cli.exit_codes import EXIT_INFEASIBLE, EXIT_OK, exit_code
from bo_tuner.codec.reading import JSON, read
from bo_tuner.evidence.certificate.parameter_sensitivity import parameter_sensitivity
from bo_tuner.evidence.facts import ApplyRefuses, Basis, Confidence
from bo_tuner.evidence.quantity import DrawsOf
from bo_tuner.evidence.run_verdict import run_verdict
from bo_tuner.evidence.verdict import FAIL, PASS, State, Status
from bo_tuner.evidence.words.next_steps import next_steps
from bo_tuner.evidence.words.terminal import print_verdict
from bo_tuner.evidence.words.verdict import (
    advice,
    as_mapping,
    basis,
    headline,
    keeps,
    mark_in_words,
    page_title,
    reasons,
    reasons_and_remarks,
    sentences,
)
from bo_tuner.methods.registry import METHODS
from bo_tuner.monitoring.diagnostics import progress
from bo_tuner.monitoring.display import Result
from bo_tuner.monitoring.json_lines import JsonLines
from bo_tuner.monitoring.status import RunStatus, Snapshot
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.comparison import comparison, verdicts_table
from bo_tuner.report.content import Chapter
from bo_tuner.report.deliverables import write_deliverables
from bo_tuner.report.page import answer_html, render, trial_html
from bo_tuner.report.sections.answer import answer
from bo_tuner.report.trial_page import trial_sections
from bo_tuner.storage.record import read_run
from bo_tuner.trials import CHECKS
from bo_tuner.tuning.validation import Validation

draws = st.lists(
    st.none() | st.tuples(st.floats(0.5, 2.0), st.floats(0.2, 1.05)), min_size=2, max_size=8
)
"""Error and peak of each draw, whose limit is 1; None for a failed one."""


def on_terminal(run, verdict):
    out = Console(file=io.StringIO(), width=300)
    tuned = run.trials[run.summary["trial"]].parameters
    print_verdict(out, run.study, verdict, tuned)
    return out.file.getvalue()


def on_page(run):
    analysis = Analysis(run)
    found = analysis.certificate_section
    sections = [] if found is None else [found]
    return render(analysis, [Chapter(name="evidence", title="Evidence", sections=sections)])


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("verdicts")


@settings(
    max_examples=20,
    suppress_health_check=list(HealthCheck),
    # An example takes a second: to shrink one would take minutes.
    phases=(Phase.explicit, Phase.reuse, Phase.generate),
)
@given(
    default=draws,
    tuned=draws,
    passed_check=st.booleans(),
    certified=st.none() | st.tuples(draws, draws),
    enough=st.booleans(),
)
def test_every_screen_says_the_same(
    tuned_run, folder, default, tuned, passed_check, certified, enough
):
    with pytest.MonkeyPatch.context() as patch:
        if enough:
            # So that a certificate of a few draws opens `apply`.
            patch.setattr("bo_tuner.evidence.certificate.store.shortfall", lambda *_: "")
        compare_screens(tuned_run, folder, default, tuned, passed_check, certified)


def compare_screens(tuned_run, folder, default, tuned, passed_check, certified):
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
        assert verdict.default_unrefuted == certificate.default.passed
    else:
        found = read(Validation, run.summary["tuned"], JSON)
        assert verdict.feasible == (passed_check and found.feasible)
        assert verdict.state is not State.CERTIFIED

    # A few draws refute, but never show what is to hold in every context.
    shown = certificate is not None
    both = list(keeps(verdict))
    for words, unrefuted in zip(both, (verdict.default_unrefuted, verdict.feasible), strict=True):
        # What is not shown need not be refuted.
        possible = {"yes" if shown else "not proven"} if unrefuted else {"NO", "not proven"}
        assert words in possible
    assert shown or "proven" not in headline(verdict).replace("Not proven", "")
    assert shown or verdict.status is not Status.GOOD

    terminal = on_terminal(run, verdict)
    assert terminal.splitlines()[0] == headline(verdict)
    (row,) = [line for line in terminal.splitlines() if line.startswith("keeps all limits")]
    assert " ".join(row.split()[3:]) == " ".join(both)
    assert not re.search(r"\b(nan|inf)\b", terminal)

    page = on_page(run)
    (title,) = re.findall(r'<h2 id="answer-title">(.*?)</h2>', page)
    told = page_title(verdict)
    assert unescape(title) == told
    plain = told.replace("\N{NO-BREAK SPACE}", " ")
    assert headline(verdict).removeprefix(f"{verdict.certificate}: ")[1:-19] in plain
    (mark,) = re.findall(r'<section id="answer" class="answer (\w+)"', page)
    assert (mark == "bad") == (not verdict.feasible)
    shown = set(re.findall(rf">\s*({PASS}|{FAIL})\s", page))
    assert shown <= {verdict.certificate}
    text = unescape(page)
    assert all(sentence in terminal for sentence in sentences(verdict))
    told_of = (*reasons_and_remarks(verdict), *advice(verdict))
    assert set(told_of) <= set(sentences(verdict))
    assert all(sentence in text for sentence in told_of)

    mapping = json.loads(json.dumps(as_mapping(verdict), allow_nan=False))
    assert mapping["headline"] == headline(verdict)
    said = {"yes": True, "NO": False, "not proven": None}
    assert list(mapping["keeps_limits"].values()) == [said[words] for words in both]
    topic = progress(run.study, Snapshot(verdict=verdict))
    assert topic.message == headline(verdict)
    assert topic.values["feasible"] == str(verdict.feasible)
    assert exit_code(verdict) == (EXIT_OK if verdict.feasible else EXIT_INFEASIBLE)

    analysis = Analysis(run)
    (row,) = verdicts_table({"run": analysis}, "").rows
    assert row[1:3] == [mark_in_words(verdict), told]
    assert row[4] == basis(verdict)
    live = unescape(answer_html(analysis))
    assert f'<h2 id="answer-title">{told}</h2>' in live
    assert all(sentence in live for sentence in told_of)
    for trial in run.trials:
        texts = unescape(trial_html(analysis, trial, trial_sections(analysis, trial)[:1]))
        assert (headline(verdict) in texts) == (trial.number == verdict.trial)
    event = json_result(run, verdict)
    assert event["verdict"] == mapping
    assert event["feasible"] == verdict.feasible
    assert event["problem"] == "; ".join(reasons(verdict))

    refusal = refusal_of_apply(run)
    assert (refusal == "") == (verdict.certificate == PASS and not verdict.apply_refuses)
    commands = [step.command for step in next_steps(verdict, "run")]
    assert not (refusal and any(command.startswith("apply") for command in commands))
    if verdict.certificate == FAIL:
        assert f"expected {PASS}, found {FAIL}" in refusal
    elif verdict.apply_refuses:
        assert ApplyRefuses(refusal) in verdict.remarks
    elif verdict.certificate != PASS:
        assert f"no certificate of trial {verdict.trial}" in refusal


class NotRefusedError(Exception):
    """`apply` has not refused the result."""


def refusal_of_apply(run):
    """The line in which `apply` refuses the result; empty if it goes on to the nodes."""

    def go_on(path):
        raise NotRefusedError

    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stderr(io.StringIO()) as said:
        patch.setattr("bo_tuner.cli.apply.read_result", lambda _: run)
        patch.setattr("bo_tuner.cli.apply.RunFolder", go_on)
        try:
            code = apply.run(["run"], SimpleNamespace())
        except NotRefusedError:
            return ""
    assert code == EXIT_INFEASIBLE
    (line,) = said.getvalue().splitlines()
    found = re.fullmatch(r"error: (.*) \(or use --without-certificate\)", line)
    return found[1]


def json_result(run, verdict):
    """The event with the result, for a run whose summary is brought up to date."""
    out = io.StringIO()
    summary = dict(run.summary) | {"feasible": verdict.feasible, "verdict": as_mapping(verdict)}
    tuned = run.trials[run.summary["trial"]].parameters
    status = RunStatus(run.study, METHODS[run.algorithm])
    JsonLines(run.study, status, out).result(
        Result(run.study, verdict, tuned, run.path / "best.yaml", summary)
    )
    return json.loads(out.getvalue())


@pytest.fixture(scope="session")
def tuned_run(tuned):
    """Function that returns the run, whose text would be too long for a failing example."""
    return lambda: tuned


@pytest.mark.parametrize("peak", [0.5, 2.0])
def test_a_certificate_brings_summary_and_bundle_up_to_date(run, peak):
    before = json.loads((run.path / "summary.json").read_text())
    tuned_draws = [(1.0 + 0.01 * k, peak + 0.001 * k) for k in range(40)]
    certificate = certify(run, [(1.0, 0.5)] * 40, tuned_draws)
    write_deliverables(run.path, lambda text: None, pytest.fail)
    verdict = run_verdict(read_run(run.path))
    assert verdict.certificate == (PASS if certificate.passed else FAIL)
    after = json.loads((run.path / "summary.json").read_text())
    bundle = json.loads((run.path / "deploy" / "provenance.json").read_text())
    assert after["verdict"] == bundle["verdict"] == as_mapping(verdict)
    assert after["feasible"] == verdict.feasible
    assert {k: v for k, v in after.items() if k not in ("verdict", "feasible")} == {
        k: v for k, v in before.items() if k not in ("verdict", "feasible")
    }


@pytest.mark.parametrize("with_default", [True, False])
def test_each_number_tells_its_draws_where_they_differ(run, with_default):
    """5 draws of the validation for both, 40 more of the certificate for the tuned one alone."""
    certify(run, [(2.0, 0.5)] * 40, [(1.0, 0.5)] * 40, with_default=with_default)
    verdict = run_verdict(run)
    (error,) = [q for q in verdict.quantities if q.label == "mean error"]
    assert error.difference.count == (40 if with_default else 5)
    assert error.draws == (None if with_default else DrawsOf(5, 40, 5))
    told = "" if with_default else "in the 5 test runs that both completed"
    # The two numbers are of these draws, and subtract to the difference.
    assert error.tuned - error.default == pytest.approx(error.difference.mean)
    if with_default:
        assert (error.default, error.tuned) == (2.0, 1.0)
    lines = on_terminal(run, verdict).splitlines()
    basis = "certificate" if with_default else f"validation; {told}"
    assert any(line.endswith(f": {basis}") for line in lines)
    assert (told in on_page(run)) if told else ("test runs that both" not in on_page(run))
    own = Basis(40, paired=False, validation=5, tuned_too=True)
    assert verdict.basis == (Basis(40) if with_default else own)
    # The two parameter sets of an attempt share its error probability.
    each = 0.98 if with_default else 0.96
    assert verdict.remarks[0] == Confidence(pytest.approx(each), 0.95, "")
    # What the limit is on, also where only the tuned parameter set was searched for it.
    (worst,) = [q for q in verdict.quantities if q.metric == "peak" and q.limit_verdict is not None]
    assert worst.label == "worst-case peak"
    assert worst.tuned == 0.5
    assert isfinite(worst.default) is with_default
    assert worst.default_unsearched is not with_default


def test_a_limit_that_makes_a_result_infeasible_is_not_kept(tuned):
    """Where nobody searched for the worst context a draw beyond the limit counts."""
    trial = default_trial(tuned).number
    run = dataclasses.replace(tuned, summary=dict(tuned.summary) | {"trial": trial})
    draws = [(1.0, 0.5)] * 7 + [(1.0, 1.1)]
    run = made(run, draws, draws, True)
    assert not run_verdict(run).feasible
    (row,) = [row for row in answer(Analysis(run)).rows if row.limit]
    assert (row.limit, row.shown, row.runs) == ("≤ 1", "not proven", "1 of 8 runs over")
    assert row.status is Status.BAD


def test_a_number_beyond_its_limit_is_not_shown_as_the_limit(tuned):
    run = made(tuned, [(1.0, 0.5)] * 8, [(1.0, 1.00002)] * 8, True)
    verdict = run_verdict(run)
    (row,) = [r for r in on_terminal(run, verdict).splitlines() if r.startswith("largest peak [N]")]
    assert row.split()[3:5] == ["0.5", "1.00002"]
    assert "1.00002" in on_page(run)
    (numbers,) = [s for s in comparison({"run": Analysis(run)}) if s.name == "numbers"]
    cells = [cell for row in numbers.tables[0].rows for cell in row[1:] if "limit" in cell]
    assert cells == [
        "1.00002 (0.5), limit 1: NOT kept: the mean over 8 test runs is above the limit"
    ]


def test_a_certificate_that_cannot_be_read_does_not_hide_a_later_one(run):
    draws = [(1.0, 0.5)] * 40
    certify(run, draws, draws)
    path = run.path / "certificates" / "0001.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"format": 3}))
    certify(run, draws, draws)
    assert run_verdict(run).certificate == Analysis(run).certificate.verdict


def test_a_limit_is_counted_or_shown_to_be_kept_in_the_same_words_everywhere(run):
    run = made(run, [(1.0, 0.5)] * 40, [(1.0, 0.5)] * 40, True)
    on_mean = "by the mean over noise in every context"
    kinds = "no rare runs are far beyond the peak of the others"
    for words, peak, status in (
        ("0 of 40 test runs above the limit", None, Status.OPEN),
        (f"shown to stay within it {on_mean}, if {kinds}", 0.5, Status.GOOD),
        (f"NOT proven to be kept {on_mean}", 2.0, Status.BAD),
    ):
        if peak is not None:
            tuned_draws = [(1.0, peak + 0.001 * k) for k in range(120)]
            certify(run, [(1.0, 0.5)] * 120, tuned_draws, repeated=120)
        analysis = Analysis(run)
        (row,) = [row for row in answer(analysis).rows if row.limit]
        assert (row.limit, row.status) == ("≤ 1", status)
        assert f": {words}" in on_terminal(run, analysis.verdict)
        (number,) = [q for q in as_mapping(analysis.verdict)["quantities"] if q["limit_verdict"]]
        assert number["limit_verdict"]["words"] == words
        (numbers,) = [s for s in comparison({"run": analysis}) if s.name == "numbers"]
        cells = [cell for row in numbers.tables[0].rows for cell in row[1:] if "limit" in cell]
        assert len(cells) == 1
        assert f"limit 1: {words}" in cells[0]


def test_the_links_of_the_report_lead_into_the_run_from_the_bundle_as_well(run):
    write_deliverables(run.path, lambda text: None, pytest.fail)
    for page, up in (("report.html", "."), ("deploy/report.html", "..")):
        text = (run.path / page).read_text(encoding="utf-8")
        links = re.findall(r'<a href="(\.[^"#]+)"', text)
        assert f"{up}/best.yaml" in links
        for link in links:
            assert (run.path / page).parent.joinpath(link).exists()


def test_a_certificate_is_of_a_parameter_set_whichever_trial_it_names(run):
    """The result was tried twice, and certified by the number of the other trial."""
    again = dataclasses.replace(run.trials[run.summary["trial"]], number=len(run.trials))
    run = dataclasses.replace(run, trials=(*run.trials, again))
    kept = [(1.0, 0.5)] * 120
    other = dataclasses.replace(run, summary=dict(run.summary) | {"trial": again.number})
    certify(made(other, kept, kept, True), kept, kept, repeated=120)
    found = answer(Analysis(made(run, kept, kept, True)))
    assert (found.mark, found.certified) == (PASS, True)
    assert found.headline.endswith("; the limit shown with an assumption")
    assert "attempt 1, 98 % confidence of each bound" in found.trust[0].text


def test_the_robustness_of_a_certificate_is_that_of_the_report(run):
    """Both by the models that the ranking has, with the repetitions among their data."""
    assert any(evaluation.stage in CHECKS for evaluation in run.evaluations)
    certificate = certify(run, [(1.0, 0.5)] * 40, [(1.0, 0.5)] * 40)
    analysis = Analysis(read_run(run.path))
    found = parameter_sensitivity(run.study, certificate.tuned.parameters, analysis.models)
    assert certificate.parameter_sensitivity == found
    (candidate,) = [c for c in analysis.ranked if c.trial.number == certificate.trial]
    assert certificate.training_gaps[0].predicted == candidate.objective
