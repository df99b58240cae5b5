"""The command: verdict and exit code, its files, and one line for each mistake.

The evaluations are those of a small object in this process.
"""

import contextlib
import dataclasses
import hashlib
import json
import os
import re
import resource
import shutil
import signal
from functools import partial
from pathlib import Path

import pytest
from axis import node, write_study
from commands import Fork, finish, run
from draws_needed import draws_needed_without_event
from in_process import call, complaint
from waiting import count_in, wait_until

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.certificate import certificate as certificate_module
from bo_tuner.certificate.run_verdict import run_verdict
from bo_tuner.certificate.store import certificate_problem, parameters_sha256
from bo_tuner.certificate.unfinished import Unfinished
from bo_tuner.cli import validate as validate_command
from bo_tuner.errors import OutputError, RunError
from bo_tuner.storage.journal import Journal
from bo_tuner.storage.provenance import session_provenance
from bo_tuner.storage.record import read_run
from bo_tuner.storage.run_folder import RunFolder
from bo_tuner.study.study_file import load_study
from bo_tuner.trials import EvaluationState, Outcome, Stage
from bo_tuner.tuning.summary import with_summary

CHANCE = {
    "peak": {"kind": "worst_case", "metric": "peak", "upper": 1.0},
    "error": {"kind": "chance", "metric": "error", "upper": 9.0, "probability": 0.96},
}
# The chance constraint has half of the error probability in the first certificate.
NEEDED = draws_needed_without_event(0.04, 0.05 / 2)


@pytest.fixture(scope="module")
def runs(tmp_path_factory, make_study):
    """Folder with a run, which is copied for each test, and with its object."""
    found = tmp_path_factory.mktemp("runs")
    noise = "(self.seed % 997) / 997"
    write_study(
        found,
        make_study(nodes=node("validated_axis"), constraints=CHANCE),
        peak=f'number("PEAK", 0.2) + 0.1 * self.load * {noise}',
    )
    code, _, err = run("tune", "--backend", "inprocess", "--study", "axis.yaml", folder=found)
    assert code == 0, err
    return found


@pytest.fixture
def folder(runs, tmp_path):
    """A copy of the run."""
    return Path(shutil.copytree((runs / "runs" / "latest").resolve(), tmp_path / "run"))


@pytest.fixture
def here(runs, monkeypatch, capsys):
    """Function that runs the command in this process; returns code, out and err."""
    monkeypatch.syspath_prepend(runs)
    return partial(call, validate_command, capsys)


@pytest.fixture
def refusal(runs, monkeypatch, capsys):
    """Function that runs the command and returns its one line of complaint."""
    monkeypatch.syspath_prepend(runs)
    return partial(complaint, validate_command, capsys)


def certificate(folder, number=1):
    return json.loads((folder / "certificates" / f"{number:04d}.json").read_text())


class TestVerdict:
    def test_pass(self, runs, folder):
        before = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
        code, out, err = run("validate", folder, "--draws", 120, folder=runs)
        assert code == 0, err
        assert out.startswith("PASS: the tuned parameter set is shown to keep all limits\n")
        assert f"certificate: {folder}/certificates/0001.json" in out
        # What it takes at most, then one line for each phase, since this is no terminal.
        most, *phases = err.splitlines()
        told = re.fullmatch(
            r"at most (\d+) evaluations \((\d+) draws, (\d+) to search for the worst contexts, "
            r"(\d+) in the worst contexts found\), fewer once the verdict is clear",
            most,
        )
        assert told, most
        total, *parts = map(int, told.groups())
        assert total == sum(parts)
        assert parts[0] == 120
        assert certificate(folder)["tuned"]["evaluations"] <= total
        assert [line.split(":")[0] for line in phases] == [
            "draws", "worst case of tuned", "warning", "report", "bundle",
        ]  # fmt: skip
        assert phases[0] == "draws: at most 120"
        assert phases[1].endswith(" evaluations")
        found = certificate(folder)
        assert (found["verdict"], found["reasons"]) == ("PASS", [])
        assert (found["draws"], found["confidence"]) == (120, 0.95)
        assert (found["drawn"], found["attempt"], found["default"]) == (NEEDED, 1, None)
        assert found["bound_confidence"] == pytest.approx(0.975)
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
        assert sum(row.startswith("tuned,validation") for row in rows) == NEEDED
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
        assert summary["verdict"]["headline"] == out.splitlines()[0]
        assert summary | {"verdict": None} == earlier | {"verdict": None}

    def test_the_numbers(self, here, folder):
        """The file has what the object gives: error 25 (gain - 0.3)^2 + load, load on [1, 2]."""
        assert here(folder, "--draws", "150", "--with-default")[0] == 0
        found = certificate(folder)
        # Each of the two has half of the share of the first attempt.
        assert found["bound_confidence"] == pytest.approx(1.0 - 0.05 / 2 / 2)
        for side, gain in (("default", 0.5), ("tuned", found["parameters"]["gain"])):
            mean = found[side]["objective"]
            expected = 25 * (gain - 0.3) ** 2 + 1.5
            assert abs(mean["value"] - expected) < 4 * (1 / 12 / NEEDED) ** 0.5
            peak, error = found[side]["constraints"]
            assert (peak["kind"], peak["limit"], peak["violations"]) == ("worst_case", 1.0, 0)
            assert peak["violation_bound"] == pytest.approx(0.04, abs=1e-3)
            assert peak["worst"][0]["shown"]
            assert peak["worst"][0]["context"]["load"] == pytest.approx(2.0, abs=0.25)
            assert error["allowed"] == pytest.approx(0.04)
        (objective, worst) = found["training_gaps"]
        assert objective["validated"] == found["tuned"]["objective"]["value"]
        assert objective["gap"] == pytest.approx(objective["validated"] - objective["observed"])
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
            assert content["bound_confidence"] == pytest.approx(1 - 0.05 / number / (number + 1))
        assert not found[0] & found[1]

    def test_the_next_in_rank_if_the_result_fails(self, here, folder, monkeypatch):
        monkeypatch.setenv("PEAK", "2")
        monkeypatch.setattr(validate_command, "required_draws", lambda *_: 1)
        code, out, _ = here(folder, "--until-pass", "3")
        assert code == 3
        # As many as there are that are believed feasible.
        count = out.count("FAIL: the tuned parameter set")
        assert 2 <= count <= 3
        tried = [certificate(folder, number)["trial"] for number in range(1, count + 1)]
        assert len(set(tried)) == count
        assert tried[0] == json.loads((folder / "summary.json").read_text())["trial"]
        assert [certificate(folder, n)["attempt"] for n in (1, 2)] == [1, 2]
        # Each takes what its own share of the error probability needs.
        assert [certificate(folder, n)["draws"] for n in (1, 2)] == [112, 142]
        monkeypatch.delenv("PEAK")
        code, out, _ = here(folder, "--until-pass", "3")
        assert (code, out.count("PASS: the tuned parameter set")) == (0, 1)

    def test_fail(self, here, folder, monkeypatch):
        monkeypatch.setenv("PEAK", "2")
        code, out, err = here(folder, "--draws", "120")
        assert code == 3, err
        assert out.startswith("FAIL: the tuned parameter set is not shown to keep all limits\n")
        found = certificate(folder)
        assert found["verdict"] == "FAIL"
        # It is clear after a few draws.
        assert found["drawn"] < 10
        reason = f"{found['drawn']} of {found['drawn']} draws violate the limit or fail: more than"
        assert found["reasons"][0].startswith(f"peak: {reason}")
        assert f"peak: NOT shown to hold: {reason}" in out

    def test_failed_evaluations(self, here, folder, monkeypatch):
        monkeypatch.setenv("FAILING", "100")
        code, out, err = here(folder, "--draws", "120")
        assert code == 3, err
        found = certificate(folder)
        assert found["tuned"]["failures"] == 1 < found["tuned"]["evaluations"]
        assert "first: axis: stalled [/x] for good (context load " in found["reasons"][0]
        assert "FAIL" in out

    def test_every_evaluation_fails(self, here, folder, monkeypatch):
        monkeypatch.setenv("FAILING", "1000")
        code, _, err = here(folder, "--draws", "120")
        assert code == 3, err
        assert certificate(folder)["tuned"]["objective"]["value"] is None

    def test_another_trial(self, here, folder):
        best = json.loads((folder / "summary.json").read_text())["trial"]
        other = (best + 1) % 5
        code, _, err = here(folder, "--draws", "120", "--trial", other)
        assert code == 0, err
        found = certificate(folder)
        assert found["trial"] == other
        assert found["best_yaml_sha256"] is None
        assert not (folder / "deploy" / "certificate.json").exists()

    def test_draws_and_confidence(self, here, folder):
        assert here(folder, "--draws", "459", "--confidence", "0.99")[0] == 0
        found = certificate(folder)
        assert (found["draws"], found["confidence"]) == (459, 0.99)
        assert found["bound_confidence"] == pytest.approx(0.995)


class TestResumeOfACertifiedRun:
    @pytest.mark.parametrize(("failing", "words"), [("", "PASS"), ("100", "FAIL")])
    def test_the_run_says_what_the_certificate_says(
        self, runs, here, folder, monkeypatch, failing, words
    ):
        """And ends with its exit code, whatever the validation of the run was."""
        if failing:
            monkeypatch.setenv("FAILING", failing)
        expected, *_ = here(folder, "--draws", "120")
        code, out, err = run("tune", "--resume", folder, folder=runs)
        assert code == expected == (0 if words == "PASS" else 3), err
        assert out.splitlines()[0].startswith(f"{words}: the tuned parameter set is ")
        assert "not certified yet" not in out
        summary = json.loads((folder / "summary.json").read_text())
        assert summary["verdict"]["headline"] == out.splitlines()[0]


class TestInterruption:
    @pytest.mark.parametrize(("signum", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
    def test_leaves_no_certificate(self, runs, folder, signum, code):
        counter = folder / "cuts"
        environment = {"CUTS": str(counter), "HOLD": "5"}
        process = Fork("validate", folder, folder=runs, env=environment)
        wait_until(lambda: count_in(counter) == 5, "the evaluation", process)
        process.send_signal(signum)
        (folder / "cuts.go").touch()
        found, _, err = finish(process)
        assert found == code, err
        said = err.splitlines()[-1]
        assert said.startswith("interrupted by SIG")
        assert said.endswith(f"; go on with: validate {folder}")
        assert [path.name for path in (folder / "certificates").iterdir()] == ["unfinished.jsonl"]

    def test_the_next_call_goes_on(self, here, folder, monkeypatch):
        """To the same certificate, bit for bit, with the evaluations left out that are there."""
        assert here(folder)[0] == 0
        whole = (folder / "certificates" / "0001_evaluations.csv").read_bytes()
        expected = certificate(folder)
        shutil.rmtree(folder / "certificates")
        outcome, count = InProcessBackend.outcome, []

        def stop(self, planned):
            count.append(planned)
            if len(count) == 60:
                raise RunError("the plug was pulled")
            return outcome(self, planned)

        monkeypatch.setattr(InProcessBackend, "outcome", stop)
        assert here(folder)[0] == 1
        unfinished = folder / "certificates" / "unfinished.jsonl"
        (begun,) = [
            remark
            for remark in run_verdict(with_summary(read_run(folder), pytest.fail)).remarks
            if "unfinished" in remark
        ]
        assert begun.startswith("An unfinished certificate has 59 evaluations")
        # A line that was cut off counts as not made.
        unfinished.write_text(unfinished.read_text()[:-9])
        code, _, err = here(folder)
        assert code == 0
        assert "going on after 58 evaluations of an interrupted certificate" in err
        assert (folder / "certificates" / "0001_evaluations.csv").read_bytes() == whole
        found = certificate(folder)
        assert found["tuned"] == expected["tuned"]
        assert len(count) == 60 + expected["tuned"]["evaluations"] - 58
        assert not unfinished.exists()
        verdict = run_verdict(with_summary(read_run(folder), pytest.fail))
        assert not any("begun" in remark for remark in verdict.remarks)

    def test_a_full_disk_at_the_beginning_loses_none_of_its_evaluations(self, here, folder):
        def begin():
            return Unfinished(folder, study, trial.parameters, "inprocess", 1)

        record = read_run(folder)
        study, trial = record.study, record.trials[0]
        begun = begin()
        for evaluation in trial.evaluations:
            begun.evaluation(evaluation)
        begun.close()
        path = folder / "certificates" / "unfinished.jsonl"
        known = path.read_text()
        # What a crash has cut off makes the next session write the file anew.
        path.write_text(f'{known}{{"trial": 0')
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (len(known) // 2, limits[1]))
        try:
            with pytest.raises(OutputError, match=r"unfinished\.jsonl: cannot be written"):
                begin()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        again = begin()
        assert len(again.evaluations) == len(trial.evaluations) > 0
        again.close()
        assert path.read_text() == known

    def test_a_link_in_its_place_is_not_followed(self, here, folder, tmp_path):
        record = read_run(folder)
        (folder / "certificates").mkdir()
        (tmp_path / "elsewhere").write_text("mine")
        (folder / "certificates" / "unfinished.jsonl").symlink_to(tmp_path / "elsewhere")
        with pytest.raises(OutputError, match="symbolic link"):
            Unfinished(folder, record.study, record.trials[0].parameters, "inprocess", 1)
        assert (tmp_path / "elsewhere").read_text() == "mine"

    def test_evaluations_of_something_else_are_discarded(self, here, folder):
        (folder / "certificates").mkdir()
        (folder / "certificates" / "unfinished.jsonl").write_text('{"attempt": 1}\n{}\n')
        verdict = run_verdict(with_summary(read_run(folder), pytest.fail))
        assert not any("begun" in remark for remark in verdict.remarks)
        code, _, err = here(folder)
        assert code == 0
        assert "going on" not in err

    def test_one_that_is_given_up_counts_as_an_attempt(self, here, folder, monkeypatch):
        """Whoever gives up what looks undecided, and tries another, would pass too often."""
        result = read_run(folder).summary["trial"]
        outcome = InProcessBackend.outcome

        def begin(*arguments):
            count = []

            def stop(self, planned):
                count.append(planned)
                if len(count) == 5:
                    raise RunError("the plug was pulled")
                return outcome(self, planned)

            with monkeypatch.context() as patch:
                patch.setattr(InProcessBackend, "outcome", stop)
                assert here(folder, *arguments)[0] == 1

        begin("--trial", str(0 if result else 1))
        # The same parameter set, twice in a row, is one attempt.
        begin()
        begin()
        assert here(folder)[0] == 0
        found = certificate(folder, 2)
        assert (found["attempt"], found["trial"]) == (2, result)
        assert not (folder / "certificates" / "0001.json").exists()


class TestFaults:
    def test_nodes_lost_for_good(self, here, folder, monkeypatch):
        lost = Outcome(EvaluationState.LOST, {}, "axis is gone")
        monkeypatch.setattr(InProcessBackend, "outcome", lambda *_: lost)
        code, out, err = here(folder)
        assert code == 1
        assert err.splitlines()[-1] == (
            "error: 3 evaluations in a row were lost with their nodes: axis is gone; "
            f"go on with: validate {folder}"
        )
        assert out == ""
        assert [path.name for path in (folder / "certificates").iterdir()] == ["unfinished.jsonl"]

    def test_a_certificate_that_cannot_be_written(self, here, folder):
        (folder / "certificates").touch()
        code, _, err = here(folder, "--draws", "120")
        assert code == 1
        assert (
            "certificates/unfinished.jsonl: cannot be written: File exists" in err.splitlines()[-1]
        )

    def test_a_crash_between_its_two_files_leaves_the_one_before(self, here, folder, monkeypatch):
        assert here(folder)[0] == 0
        write = certificate_module.write_atomically

        def crash(path, content):
            if path.suffix == ".json":
                raise OutputError(f"{path}: cannot be written: No space left on device")
            return write(path, content)

        with monkeypatch.context() as patch:
            patch.setattr(certificate_module, "write_atomically", crash)
            assert here(folder)[0] == 1
        names = {path.name for path in (folder / "certificates").iterdir()}
        assert names == {
            "0001.json",
            "0001_evaluations.csv",
            "0002_evaluations.csv",
            "unfinished.jsonl",
        }
        record = read_run(folder)
        assert certificate_problem(record, record.trials[record.summary["trial"]]) == ""
        # Nothing is run again, and the attempt keeps its share of the error probability.
        code, _, err = here(folder)
        assert code == 0
        assert "going on after" in err
        assert certificate(folder, 2)["attempt"] == 2


class TestKey:
    """What opens `apply`."""

    def problem(self, folder):
        record = read_run(folder)
        return certificate_problem(record, record.trials[record.summary["trial"]])

    def test_a_quick_look_does_not(self, here, folder):
        code, _, err = here(folder, "--draws", "100", "--confidence", "0.001")
        assert code == 0
        assert (
            "warning: not sufficient for apply: made with 100 draws, the study requires 1000" in err
        )
        assert "the study requires 1000" in self.problem(folder)

    def test_a_quick_look_does_not_replace_a_fail(self, here, folder, monkeypatch):
        monkeypatch.setenv("PEAK", "1.5")
        assert here(folder)[0] == 3
        monkeypatch.delenv("PEAK")
        assert here(folder, "--draws", "100", "--confidence", "0.001")[0] == 0
        assert certificate(folder, 1)["verdict"] == "FAIL"
        assert certificate(folder, 2)["verdict"] == "PASS"
        assert "0002.json: made with 100 draws" in self.problem(folder)

    def test_by_default_it_is_what_the_study_requires(self, here, folder):
        assert here(folder)[0] == 0
        assert certificate(folder)["draws"] == 1000
        assert self.problem(folder) == ""


class TestBadInput:
    @pytest.mark.parametrize(
        ("arguments", "complaint"),
        [
            (
                ["--draws", str(NEEDED - 1)],
                f"--draws: expected at least {NEEDED} to show error, even if none viol",
            ),
            (["--until-pass", "0"], "--until-pass: expected at least 1, found 0"),
            (["--until-pass", "20000"], "--until-pass: expected at most 10000, found 20000"),
            (["--draws", "-1"], f"--draws: expected at least {NEEDED}"),
            # The second attempt has a smaller share of the error probability.
            (["--draws", "112", "--until-pass", "2"], "--draws: expected at least 142 to show"),
            (["--draws", "many"], "argument --draws: many: expected a whole number"),
            (["--draws", "300", "--confidence", "0.999999"], "--draws: expected at least 3"),
            (["--confidence", "95"], "argument --confidence: 95: expected a number between 0 and"),
            (["--confidence", "nan"], "argument --confidence: nan: expected a number between"),
            (["--confidence", "high"], "argument --confidence: high: expected a number between"),
            (["--trial", "5"], "no trial 5; expected 0 to 4"),
            (["--trial", "-1"], "no trial -1; expected 0 to 4"),
            (["--trial", "best"], "argument --trial: best: expected a whole number"),
            (["--attach"], "--attach needs --backend ros"),
            (["--backend", "ross"], "argument --backend: invalid choice: 'ross'"),
            (["--seed", "3"], "unrecognized arguments: --seed 3"),
        ],
    )
    def test_options(self, refusal, folder, arguments, complaint):
        assert complaint in refusal(folder, *arguments)

    def test_no_run(self, refusal, tmp_path):
        assert "the following arguments are required: RUN" in refusal()
        assert "nowhere: no such run folder" in refusal(tmp_path / "nowhere")
        assert "it has no study.yaml" in refusal(tmp_path)

    def test_a_run_without_a_result(self, refusal, folder):
        study = load_study(folder / "study.yaml")
        # A session that began to continue the run.
        provenance = session_provenance(study.replace(trials=9), "inprocess", "IV")
        with Journal(folder / "journal.sqlite", provenance):
            pass
        line = refusal(folder, warnings=1)
        assert "has no result: it has not ended, or every trial failed; continue with" in line

    def test_a_run_that_ended_in_its_first_trial(self, refusal, tmp_path, runs):
        study = load_study(runs / "axis.yaml")
        with contextlib.closing(RunFolder.create(tmp_path / "begun", study)) as begun:
            begun.write_study(study)
            provenance = session_provenance(study, "inprocess", "boundary")
            with Journal(begun.journal, provenance):
                pass
        for option in ([], ["--until-pass", "3"]):
            assert "has no result: it has not ended" in refusal(begun.path, *option)

    def test_a_parameter_file_of_other_values(self, refusal, folder):
        """A certificate must not be of what the file does not hold."""
        text = (folder / "best.yaml").read_text()
        changed = re.sub(r"gain: .*", "gain: 0.9", text)
        assert changed != text
        (folder / "best.yaml").write_text(changed)
        assert "best.yaml: does not hold the values of trial " in refusal(folder)

    @pytest.mark.parametrize("content", [None, "{", ""])
    def test_a_parameter_file_that_is_lost_is_made_anew(self, here, folder, content):
        text = (folder / "best.yaml").read_text()
        (folder / "best.yaml").unlink()
        if content is not None:
            (folder / "best.yaml").write_text(content)
        code, _, err = here(folder, "--draws", "120")
        assert code == 0
        assert "best.yaml: missing or damaged; made from the journal" in err
        assert (folder / "best.yaml").read_text() == text

    def test_a_run_that_is_going_on(self, refusal, folder):
        held = RunFolder(folder)
        try:
            line = refusal(folder)
        finally:
            held.close()
        assert f"another process works in this run (process {os.getpid()})" in line


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


def test_a_certificate_is_in_the_files_of_the_run_though_the_next_one_breaks_off(
    here, folder, monkeypatch
):
    monkeypatch.setenv("PEAK", "2")
    outcome, made = InProcessBackend.outcome, []

    def stop(self, planned):
        if (folder / "certificates" / "0001.json").exists():
            made.append(planned)
            raise RunError("the plug was pulled")
        return outcome(self, planned)

    monkeypatch.setattr(InProcessBackend, "outcome", stop)
    code, _, err = here(folder, "--until-pass", "3")
    assert code == 1
    assert made
    assert "go on with: validate" in err
    assert json.loads((folder / "summary.json").read_text())["feasible"] is False
