"""An attempt that is interrupted goes on, or counts; a fault is named and leaves what there is."""

import json
import resource
import shutil
import signal

import pytest
from commands import Fork, finish
from validated_run import certificate
from waiting import count_in, wait_until

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.cli.time_limit import TimeLimit
from bo_tuner.errors import OutputError, RunError
from bo_tuner.evidence import certificate_file
from bo_tuner.evidence.certificate.store import certificate_problem
from bo_tuner.evidence.certificate.unfinished import Unfinished
from bo_tuner.evidence.facts import CertificateBegun
from bo_tuner.evidence.run_verdict import run_verdict
from bo_tuner.storage.record import read_run
from bo_tuner.trials import EvaluationState, Outcome
from bo_tuner.tuning.summary import with_summary


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
        assert said.endswith(f"; continue with: validate {folder}")
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
        verdict = run_verdict(with_summary(read_run(folder), pytest.fail))
        assert CertificateBegun(59) in verdict.remarks
        # A line that was cut off counts as not made.
        unfinished.write_text(unfinished.read_text()[:-9])
        code, _, err = here(folder)
        assert code == 0
        assert f"certificate of trial {expected['trial']} after 58 test runs" in err
        assert (folder / "certificates" / "0001_evaluations.csv").read_bytes() == whole
        found = certificate(folder)
        assert found["tuned"] == expected["tuned"]
        assert len(count) == 60 + expected["tuned"]["evaluations"] - 58
        assert not unfinished.exists()
        verdict = run_verdict(with_summary(read_run(folder), pytest.fail))
        assert not any(isinstance(fact, CertificateBegun) for fact in verdict.remarks)

    def test_the_end_of_its_time_says_what_is_shown(self, here, folder, monkeypatch):
        """The next call goes on to the same certificate as one without an end."""
        assert here(folder)[0] == 0
        whole = (folder / "certificates" / "0001_evaluations.csv").read_bytes()
        shutil.rmtree(folder / "certificates")
        outcome, count = InProcessBackend.outcome, []

        def run(self, planned):
            count.append(planned)
            return outcome(self, planned)

        monkeypatch.setattr(InProcessBackend, "outcome", run)
        with monkeypatch.context() as timed:
            timed.setattr(TimeLimit, "over", property(lambda _: len(count) >= 20))
            code, out, err = here(folder, "--time", "10min")
        assert (code, out, len(count)) == (1, "", 20)
        said = err.splitlines()
        (first,) = [k for k, line in enumerate(said) if line.startswith("the time is over")]
        assert said[first] == (
            "the time is over, without a verdict: 20 test runs, nothing refutes it; shown with "
            "96 % confidence:"
        )
        assert said[first + 1].startswith("  peak: at least 0.")
        assert said[first + 2].startswith("  error: at least 0.")
        assert said[-1] == f"continue with: validate {folder} --time 10min"
        assert [path.name for path in (folder / "certificates").iterdir()] == ["unfinished.jsonl"]
        assert here(folder)[0] == 0
        assert (folder / "certificates" / "0001_evaluations.csv").read_bytes() == whole

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

    def test_a_full_disk_in_between_is_named_with_the_way_on(self, here, folder):
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (5000, limits[1]))
        try:
            code, _, err = here(folder)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert code == 1
        unfinished = folder / "certificates" / "unfinished.jsonl"
        assert err.splitlines()[-1] == (
            f"error: {unfinished}: cannot be written: No space left on device; "
            f"continue with: validate {folder}"
        )
        code, _, err = here(folder)
        assert code == 0
        assert "continuing the interrupted certificate" in err

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
        assert not any(isinstance(fact, CertificateBegun) for fact in verdict.remarks)
        code, _, err = here(folder)
        assert code == 0
        assert "continuing" not in err

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

    def test_of_several_the_one_that_was_interrupted_goes_on(self, here, folder, monkeypatch):
        """The result has its certificate, and is not certified again."""
        monkeypatch.setenv("PEAK", "2")
        assert here(folder, "--runs", "200")[0] == 3
        result = read_run(folder).summary["trial"]
        outcome, count = InProcessBackend.outcome, []

        def stop(self, planned):
            count.append(planned)
            if len(count) == 5:
                raise RunError("the plug was pulled")
            return outcome(self, planned)

        other = 0 if result else 1
        monkeypatch.delenv("PEAK")
        with monkeypatch.context() as patch:
            patch.setattr(InProcessBackend, "outcome", stop)
            assert here(folder, "--trial", str(other), "--runs", "200")[0] == 1
        code, _, err = here(folder, "--until-pass", "3")
        assert code == 0
        assert f"continuing the interrupted certificate of trial {other} after 4 test runs" in err
        found = certificate(folder, 2)
        assert (found["attempt"], found["trial"]) == (2, other)


class TestFaults:
    def test_nodes_lost_for_good(self, here, folder, monkeypatch):
        lost = Outcome(EvaluationState.LOST, {}, "axis is gone")
        monkeypatch.setattr(InProcessBackend, "outcome", lambda *_: lost)
        code, out, err = here(folder)
        assert code == 1
        assert err.splitlines()[-1] == (
            "error: 3 test runs in a row were lost with their nodes: axis is gone; "
            f"continue with: validate {folder}"
        )
        assert out == ""
        assert [path.name for path in (folder / "certificates").iterdir()] == ["unfinished.jsonl"]

    def test_a_certificate_that_cannot_be_written(self, here, folder):
        (folder / "certificates").touch()
        code, _, err = here(folder, "--runs", "120")
        assert code == 1
        assert (
            "certificates/unfinished.jsonl: cannot be written: File exists" in err.splitlines()[-1]
        )

    def test_a_crash_between_its_two_files_leaves_the_one_before(self, here, folder, monkeypatch):
        assert here(folder)[0] == 0
        write = certificate_file.write_atomically

        def crash(path, content):
            if path.suffix == ".json":
                raise OutputError(f"{path}: cannot be written: No space left on device")
            return write(path, content)

        with monkeypatch.context() as patch:
            patch.setattr(certificate_file, "write_atomically", crash)
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
        assert "continuing the interrupted certificate" in err
        assert certificate(folder, 2)["attempt"] == 2


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
    assert "continue with: validate" in err
    assert json.loads((folder / "summary.json").read_text())["feasible"] is False
