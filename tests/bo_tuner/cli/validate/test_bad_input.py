"""One line for each mistake, ahead of any run."""

import contextlib
import re

import pytest
from validated_run import NEEDED

from bo_tuner.storage.journal import Journal
from bo_tuner.storage.provenance import session_provenance
from bo_tuner.storage.run_folder import RunFolder
from bo_tuner.study.study_file import load_study


class TestBadInput:
    @pytest.mark.parametrize(
        ("arguments", "complaint"),
        [
            (
                ["--runs", str(NEEDED - 1)],
                f"--runs: expected at least {NEEDED} to show error, even if none viol",
            ),
            (["--until-pass", "0"], "--until-pass: expected at least 1, found 0"),
            (["--until-pass", "20000"], "--until-pass: expected at most 10000, found 20000"),
            (["--runs", "-1"], f"--runs: expected at least {NEEDED}"),
            # The second attempt has a smaller share of the error probability.
            (["--runs", "99", "--until-pass", "2"], "--runs: expected at least 156 to show"),
            (["--runs", "many"], "argument --runs: many: expected a whole number"),
            (["--runs", "300", "--confidence", "0.999999"], "--runs: expected at least 3"),
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
        code, _, err = here(folder, "--runs", "120")
        assert code == 0
        assert "best.yaml: missing or damaged; made from the journal" in err
        assert (folder / "best.yaml").read_text() == text

    def test_a_run_that_is_going_on(self, refusal, folder):
        held = RunFolder(folder)
        try:
            line = refusal(folder)
        finally:
            held.close()
        assert "this process is using this run folder already" in line
