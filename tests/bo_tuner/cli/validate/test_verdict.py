"""Verdict, exit code and files of a certificate, and which one opens `apply`."""

import dataclasses
import hashlib
import json
import re

import pytest
from commands import run
from validated_run import NEEDED, certificate

from bo_tuner.cli import validate as validate_command
from bo_tuner.cli.validate import MOST_LINES
from bo_tuner.evidence.certificate import store
from bo_tuner.evidence.certificate.store import certificate_problem, parameters_sha256
from bo_tuner.monitoring import now_and_then
from bo_tuner.storage.record import read_run
from bo_tuner.trials import EvaluationState, Outcome, Stage
from bo_tuner.tuning.summary import with_summary


class TestVerdict:
    def test_pass(self, runs, folder):
        before = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
        code, out, err = run("validate", folder, "--runs", 120, folder=runs)
        assert code == 0, err
        # The screen may be narrower.
        assert " ".join(out.split()).startswith(
            "PASS: error -43 %; both limits shown with an assumption"
        )
        assert f"certificate: {folder}/certificates/0001.json" in out
        assert len(out.splitlines()) <= 1 + MOST_LINES
        # What it takes at most, then one line for each phase, since this is no terminal.
        warning, most, *phases = err.splitlines()
        assert "apply will refuse a PASS" in warning
        phases = [line for line in phases if not line.startswith("probably ")]
        told = re.fullmatch(
            r"at most (\d+) test runs \((\d+) at random, (\d+) to search for the worst contexts, "
            r"(\d+) in the worst contexts found\), fewer once the verdict is clear",
            most,
        )
        assert told, most
        total, *parts = map(int, told.groups())
        assert total == sum(parts)
        assert parts[0] == 120
        assert certificate(folder)["tuned"]["evaluations"] <= total
        assert [line.split(":")[0] for line in phases] == [
            "test runs at random", "worst case of tuned", "report",
        ]  # fmt: skip
        assert phases[0] == "test runs at random: at most 120"
        # No phase has more steps than it said.
        assert all(" at most " in line for line in phases[:2])
        found = certificate(folder)
        assert (found["verdict"], found["reasons"]) == ("PASS", [])
        assert (found["draws"], found["confidence"]) == (120, 0.95)
        assert (found["attempt"], found["default"]) == (1, None)
        assert found["drawn"] == NEEDED < found["tuned"]["evaluations"]
        assert found["bound_confidence"] == pytest.approx(0.96)
        summary = json.loads((folder / "summary.json").read_text())
        assert found["trial"] == summary["trial"]
        assert found["parameters"] == summary["tuned"]["parameters"]
        assert found["parameters_sha256"] == parameters_sha256(found["parameters"])
        best = (folder / "best.yaml").read_bytes()
        assert found["best_yaml_sha256"] == hashlib.sha256(best).hexdigest()
        study = hashlib.sha256((folder / "study.yaml").read_bytes()).hexdigest()
        assert found["study_sha256"] == found["provenance"]["study_sha256"] == study
        evaluations = (folder / "certificates" / "0001_evaluations.csv").read_bytes()
        assert found["evaluations_sha256"] == hashlib.sha256(evaluations).hexdigest()
        rows = evaluations.decode().splitlines()[1:]
        assert len(rows) == found["tuned"]["evaluations"]
        assert sum(row.startswith("tuned,validation") for row in rows) == found["drawn"]
        # All else of the run is as it was; a reader of the journal leaves files of its own.
        names = {path.name for path in folder.iterdir() if path.is_file()}
        new = {name for name in names - set(before) if not name.startswith("journal")}
        assert new == set()
        of_certificate = {path.name for path in (folder / "certificates").iterdir()}
        assert of_certificate == {"0001.json", "0001_evaluations.csv"}
        assert all(
            (folder / name).read_bytes() == content
            for name, content in before.items()
            if name not in (".lock", "report.html", "summary.json")
        )
        # The summary has the verdict by this certificate.
        earlier = json.loads(before["summary.json"])
        assert summary["verdict"]["state"] == "certified"
        assert " ".join(out.split()).startswith(summary["verdict"]["headline"])
        assert summary | {"verdict": None} == earlier | {"verdict": None}

    def test_the_numbers(self, here, folder):
        """The file has what the object gives: error 25 (gain - 0.3)^2 + load, load on [1, 2]."""
        assert here(folder, "--runs", "150", "--with-default")[0] == 0
        found = certificate(folder)
        # Each of the two has half of the share of the first attempt.
        assert found["bound_confidence"] == pytest.approx(1.0 - 0.04 / 2)
        for side, gain in (("default", 0.5), ("tuned", found["parameters"]["gain"])):
            mean = found[side]["objective"]
            expected = 25 * (gain - 0.3) ** 2 + 1.5
            assert abs(mean["value"] - expected) < 4 * (1 / 12 / found["drawn"]) ** 0.5
            peak, error = found[side]["constraints"]
            assert (peak["kind"], peak["limit"], peak["violations"]) == ("worst_case", 1.0, 0)
            assert peak["violation_bound"] == pytest.approx(0.04, abs=1e-3)
            assert peak["worst"][0]["shown"]
            assert peak["worst"][0]["context"]["load"] == pytest.approx(2.0, abs=0.25)
            assert error["allowed"] == pytest.approx(0.04)
        (objective, worst) = found["training_gaps"]
        assert objective["validated"] == found["tuned"]["objective"]["value"]
        assert worst["unit"] == ""
        assert found["context_tolerances"][0]["variables"][0]["name"] == "load"
        assert found["parameter_sensitivity"]["optimum"]["parameters"]["gain"] == gain

    def test_each_attempt_has_own_draws_and_a_smaller_share(self, here, folder):
        found = []
        for number in (1, 2):
            assert here(folder)[0] == 0
            evaluations = (folder / "certificates" / f"{number:04d}_evaluations.csv").read_text()
            found.append(set(evaluations.splitlines()[1:]))
            content = certificate(folder, number)
            assert content["attempt"] == number
            assert content["bound_confidence"] == pytest.approx({1: 0.96, 2: 0.995}[number])
        assert not found[0] & found[1]

    def test_the_next_in_rank_if_the_result_fails(self, here, folder, monkeypatch):
        monkeypatch.setenv("PEAK", "2")
        monkeypatch.setattr(store, "required_draws", lambda *_: 1)
        code, out, _ = here(folder, "--until-pass", "3")
        assert code == 3
        # As many as there are that are believed feasible.
        count = out.count("FAIL: not proven to stay within")
        assert 2 <= count <= 3
        tried = [certificate(folder, number)["trial"] for number in range(1, count + 1)]
        assert len(set(tried)) == count
        assert tried[0] == json.loads((folder / "summary.json").read_text())["trial"]
        assert [certificate(folder, n)["attempt"] for n in (1, 2)] == [1, 2]
        # Each takes what its own share of the error probability needs.
        assert [certificate(folder, n)["draws"] for n in (1, 2)] == [99, 156]
        monkeypatch.delenv("PEAK")
        code, out, _ = here(folder, "--until-pass", "3")
        assert (code, out.count("PASS: ")) == (0, 1)

    def test_with_the_default_the_screen_is_as_short(self, here, folder):
        code, out, err = here(folder, "--runs", "150", "--with-default")
        assert code == 0, err
        assert len(out.splitlines()) <= 1 + MOST_LINES
        assert "peak: shown, if " in out
        assert "The default is " in out

    def test_progress_is_told_now_and_then_where_no_terminal_is(self, here, folder, monkeypatch):
        monkeypatch.setattr(now_and_then, "PERIOD", 0.0)
        code, _, err = here(folder, "--runs", "150")
        assert code == 0, err
        found = certificate(folder)["drawn"]
        lines = [line for line in err.splitlines() if "at random: " in line]
        assert lines[0] == "test runs at random: at most 150"
        told = [line.partition(": ")[::2] for line in lines[1:] if " of " in line]
        phases = dict.fromkeys(phase for phase, _ in told)
        count = {phase: sum(name == phase for name, _ in told) for phase in phases}
        assert sum(count.values()) == found
        for phase, number in count.items():
            steps = [said.split()[0] for name, said in told if name == phase]
            assert steps == [str(k) for k in range(1, number + 1)]
        totals = [said.replace(",", "").split()[:3:2] for _, said in told]
        assert all(int(done) <= int(total) for done, total in totals)

    def test_fail(self, here, folder, monkeypatch):
        monkeypatch.setenv("PEAK", "2")
        code, out, err = here(folder, "--runs", "120")
        assert code == 3, err
        assert out.startswith("FAIL: not proven to stay within the limits of peak and error\n")
        found = certificate(folder)
        assert found["verdict"] == "FAIL"
        # It is clear after a few draws.
        assert found["drawn"] < 10
        reason = (
            f"{found['drawn']} of {found['drawn']} test runs violate the limit or fail: more than"
        )
        assert found["reasons"][0].startswith(f"peak: {reason}")
        assert f"peak: NOT proven: {reason}" in out

    def test_failed_evaluations(self, here, folder, monkeypatch):
        monkeypatch.setenv("FAILING", "100")
        code, out, err = here(folder, "--runs", "120")
        assert code == 3, err
        found = certificate(folder)
        assert found["tuned"]["failures"] == 1 < found["tuned"]["evaluations"]
        assert "first: axis: stalled [/x] for good (context load " in found["reasons"][0]
        assert "FAIL" in out

    def test_every_evaluation_fails(self, here, folder, monkeypatch):
        monkeypatch.setenv("FAILING", "1000")
        code, _, err = here(folder, "--runs", "120")
        assert code == 3, err
        assert certificate(folder)["tuned"]["objective"]["value"] is None

    def test_another_trial(self, here, folder):
        best = json.loads((folder / "summary.json").read_text())["trial"]
        other = (best + 1) % 5
        code, _, err = here(folder, "--runs", "120", "--trial", other)
        assert code == 0, err
        found = certificate(folder)
        assert found["trial"] == other
        assert found["best_yaml_sha256"] is None
        assert not (folder / "deploy" / "certificate.json").exists()

    def test_draws_and_confidence(self, here, folder):
        assert here(folder, "--runs", "459", "--confidence", "0.99")[0] == 0
        found = certificate(folder)
        assert (found["draws"], found["confidence"]) == (459, 0.99)
        assert found["bound_confidence"] == pytest.approx(0.992)


class TestResumeOfACertifiedRun:
    @pytest.mark.parametrize(("failing", "words"), [("", "PASS"), ("100", "FAIL")])
    def test_the_run_says_what_the_certificate_says(
        self, runs, here, folder, monkeypatch, failing, words
    ):
        """And ends with its exit code, whatever the validation of the run was."""
        if failing:
            monkeypatch.setenv("FAILING", failing)
        expected, *_ = here(folder, "--runs", "120")
        code, out, err = run("tune", "--resume", folder, folder=runs)
        assert code == expected == (0 if words == "PASS" else 3), err
        assert out.splitlines()[0].startswith(f"{words}: ")
        assert "not certified yet" not in out
        summary = json.loads((folder / "summary.json").read_text())
        assert " ".join(out.split()).startswith(summary["verdict"]["headline"])


class TestKey:
    """What opens `apply`."""

    def problem(self, folder):
        record = read_run(folder)
        return certificate_problem(record, record.trials[record.summary["trial"]])

    def test_a_quick_look_does_not(self, here, folder):
        code, _, err = here(folder, "--runs", "100", "--confidence", "0.001")
        assert code == 0
        said = "warning: apply will refuse a PASS: made with 100 test runs, the study requires 1000"
        assert said in err
        # Before the runs.
        assert err.index(said) < err.index("at random", err.index(said) + len(said))
        assert "the study requires 1000" in self.problem(folder)

    def test_a_quick_look_does_not_replace_a_fail(self, here, folder, monkeypatch):
        monkeypatch.setenv("PEAK", "1.5")
        assert here(folder)[0] == 3
        monkeypatch.delenv("PEAK")
        assert here(folder, "--runs", "100", "--confidence", "0.001")[0] == 0
        assert certificate(folder, 1)["verdict"] == "FAIL"
        assert certificate(folder, 2)["verdict"] == "PASS"
        assert "0002.json: made with 100 test runs" in self.problem(folder)

    def test_by_default_it_is_what_the_study_requires(self, here, folder):
        assert here(folder)[0] == 0
        assert certificate(folder)["draws"] == 1000
        assert self.problem(folder) == ""


@pytest.mark.parametrize("algorithm", ["boundary", "IV"])
def test_what_failed_when_it_was_run_again_is_not_tried_next(folder, algorithm):
    record = with_summary(read_run(folder), pytest.fail)
    record = dataclasses.replace(record, algorithm=algorithm)
    (_, following) = validate_command._candidates(record, record.result, 2)
    (last, *_) = [e for e in record.evaluations if e.trial == following.number]
    again = dataclasses.replace(
        last,
        index=1000,
        stage=Stage.CHECK_DRAWN,
        outcome=Outcome(EvaluationState.FAILED, reason="axis: stalled"),
    )
    record = dataclasses.replace(record, evaluations=(*record.evaluations, again))
    others = list(validate_command._candidates(record, record.result, len(record.trials)))
    assert following not in others
    assert all(trial in record.trials for trial in others)


def test_the_files_of_the_run_tell_the_confidence_of_all_certificates(here, folder):
    """The lowest one that was asked for, of whichever trial."""
    result = read_run(folder).summary["trial"]
    other = 0 if result else 1
    assert here(folder)[0] == 0
    here(folder, "--trial", str(other), "--confidence", "0.5")
    assert "have 50 % together" in (folder / "report.html").read_text()
