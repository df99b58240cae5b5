"""Functions in processes of their own: workers, and runs that take too long."""

import contextlib
import os
import subprocess
import sys
import threading
import time

import pytest
from waiting import wait_until

import bo_tuner as bt
from bo_tuner.storage.journal_reader import read_journal

RESULTS = ("trials.csv", "best.yaml", "summary.json")
RELATIVE = {"peak": {"kind": "worst_case", "metric": "peak", "upper": "1.1 * default"}}


@pytest.fixture
def function():
    """One that no module has, so that it is passed with its code."""

    def response(parameters, context, seed):
        gain, load = parameters["gain"], context["load"]
        return {"error": 1.0 + load * (gain - 0.3) ** 2, "peak": 2.0 * gain * load}

    return response


def outcomes(folder):
    return [e.outcome for e in read_journal(folder / "journal.sqlite").evaluations]


class TestWorkers:
    @pytest.mark.parametrize(
        "constraints",
        [None, pytest.param(RELATIVE, marks=pytest.mark.slow)],
        ids=["absolute", "relative"],
    )
    def test_the_result_depends_on_the_window_and_not_on_them(
        self, make_function_study, function, tmp_path, constraints
    ):
        def marked(parameters, context, seed):
            (tmp_path / str(os.getpid())).touch()
            return function(parameters, context, seed)

        sections = {} if constraints is None else {"constraints": constraints}
        study = make_function_study(6, **sections)
        study.optimize(marked, tmp_path / "two", workers=2)
        pids = {int(path.name) for path in tmp_path.iterdir() if path.name.isdigit()}
        assert len(pids) == 2
        assert os.getpid() not in pids
        study.optimize(function, tmp_path / "one", window=2)
        for name in RESULTS:
            found = (tmp_path / "two" / name).read_bytes()
            assert found == (tmp_path / "one" / name).read_bytes(), name

    def test_a_certificate_by_them(self, make_function_study, function, tmp_path):
        study = make_function_study(constraints={"peak": bt.WorstCase("peak", upper=2.0)})
        values = {"gain": 0.4}
        by_two = bt.certify(function, study, values, runs=80, workers=2)
        assert by_two.passed
        alone = bt.certify(function, study, values, runs=80)
        assert by_two.reasons == alone.reasons

    def test_what_is_no_result_ends_the_call(self, make_function_study, tmp_path):
        with pytest.raises(bt.MetricsError, match="metric peak is missing; expected a number"):
            make_function_study().optimize(lambda *_: {"error": 1.0}, tmp_path / "run", workers=2)

    def test_a_run_that_ends_its_process(self, make_function_study, tmp_path):
        """Another process takes its place, and the run is made again there."""

        def exits(parameters, context, seed):
            # In the first of them.
            with contextlib.suppress(FileExistsError):
                (tmp_path / "left").touch(exist_ok=False)
                sys.exit("left")
            return {"error": 1.0, "peak": parameters["gain"]}

        make_function_study(3).optimize(exits, tmp_path / "run", workers=2)
        assert {outcome.reason for outcome in outcomes(tmp_path / "run")} == {""}

    def test_a_function_that_cannot_be_passed(self, make_function_study, tmp_path):
        lock = threading.Lock()

        def locked(parameters, context, seed):
            with lock:
                return {"error": 1.0, "peak": 1.0}

        study = make_function_study()
        said = "the function cannot be passed to another process, .* cannot pickle '_thread.lock'"
        for given in ({"workers": 2}, {"timeout": 1.0}):
            with pytest.raises(bt.FunctionError, match=said):
                study.optimize(locked, tmp_path / "run", **given)
            with pytest.raises(bt.FunctionError, match=said):
                bt.certify(locked, study, **given)
        assert not (tmp_path / "run").exists()

    def test_numbers_of_them_that_cannot_be(self, make_function_study, function):
        study = make_function_study()
        for workers in (0, 1.5, "4", True, 1000):
            with pytest.raises(bt.StudyError, match="workers: expected"):
                study.optimize(function, workers=workers)
            with pytest.raises(bt.StudyError, match="workers: expected"):
                bt.certify(function, study, workers=workers)

    def test_a_script_that_each_of_them_would_run_again(self, make_function_study, tmp_path):
        (tmp_path / "study.yaml").write_text(make_function_study().to_yaml(), encoding="utf-8")
        script = tmp_path / "script.py"
        script.write_text(
            "import logging\nimport sys\nimport bo_tuner as bt\n"
            "logging.getLogger(__name__)\n"
            "bt.Study.from_yaml(sys.argv[1]).optimize(lambda *_: {}, workers=2)\n",
            encoding="utf-8",
        )
        command = [sys.executable, script, tmp_path / "study.yaml"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 1
        last = done.stderr.splitlines()[-1]
        assert f"each worker imports {script}, and would run all of it again; put the call" in last

    def test_without_their_packages(self, make_function_study, function, monkeypatch):
        study = make_function_study()
        monkeypatch.setitem(sys.modules, "distributed", None)
        with pytest.raises(bt.BackendError, match=r"pip install 'bo_tuner\[workers\]'"):
            study.optimize(function, workers=2)
        monkeypatch.setitem(sys.modules, "cloudpickle", None)
        for given in ({"workers": 2}, {"timeout": 1.0}):
            with pytest.raises(bt.MissingPackageError, match=r"pip install 'bo_tuner\[workers\]'"):
                study.optimize(function, **given)

    def test_the_number_in_the_budget(self, make_function_study, monkeypatch, function):
        """A study with workers has them also without the argument."""
        monkeypatch.setitem(sys.modules, "distributed", None)
        budget = bt.Budget(trials=4, initial_trials=3, workers=2)
        with pytest.raises(bt.BackendError, match="several workers need"):
            make_function_study(budget=budget).optimize(function)


class TestTimeout:
    def test_a_run_that_hangs_has_failed_by_name(self, make_function_study, tmp_path):
        def hangs(parameters, context, seed):
            gain, load = parameters["gain"], context["load"]
            if gain > 0.45:
                (tmp_path / "pid").write_text(str(os.getpid()))
                time.sleep(1000.0)
            return {"error": 1.0 + load * (gain - 0.3) ** 2, "peak": 2.0 * gain * load}

        study = make_function_study()
        result = study.optimize(hangs, tmp_path / "run", timeout=0.5)
        found = {outcome.reason for outcome in outcomes(tmp_path / "run")}
        assert found == {"", "took longer than its timeout of 0.5 s"}
        assert result.best["gain"] <= 0.45
        with pytest.raises(ProcessLookupError):
            os.kill(int((tmp_path / "pid").read_text()), 0)
        certificate = bt.certify(hangs, study, {"gain": 0.6}, runs=80, timeout=0.5)
        assert not certificate.passed

    @pytest.mark.slow
    def test_by_workers_as_well(self, make_function_study, tmp_path):
        def hangs(parameters, context, seed):
            if parameters["gain"] > 0.45:
                time.sleep(1000.0)
            return {"error": 1.0, "peak": parameters["gain"]}

        make_function_study().optimize(hangs, tmp_path / "run", timeout=0.5, workers=2)
        found = {outcome.reason for outcome in outcomes(tmp_path / "run")}
        assert found == {"", "took longer than its timeout of 0.5 s"}

    def test_the_result_is_that_without_one(self, make_function_study, function, tmp_path):
        for name, given in (("with", {"timeout": 60.0}), ("without", {})):
            make_function_study().optimize(function, tmp_path / name, **given)
        for name in RESULTS:
            found = (tmp_path / "with" / name).read_bytes()
            assert found == (tmp_path / "without" / name).read_bytes(), name

    def test_a_run_that_ends_its_process_has_failed(self, make_function_study, tmp_path):
        def crashes(parameters, context, seed):
            if parameters["gain"] > 0.45:
                os.abort()
            return {"error": 1.0, "peak": parameters["gain"]}

        make_function_study().optimize(crashes, tmp_path / "run", timeout=60.0)
        found = {outcome.reason for outcome in outcomes(tmp_path / "run")}
        assert found == {"", "ended its process: killed by SIGABRT"}

    def test_a_function_whose_forked_child_returns_too(self, make_function_study, tmp_path):
        def forks(parameters, context, seed):
            if child := os.fork():
                os.waitpid(child, os.WNOHANG)
            return {"error": parameters["gain"], "peak": context["load"]}

        make_function_study().optimize(forks, tmp_path / "run", timeout=60.0)
        for evaluation in read_journal(tmp_path / "run" / "journal.sqlite").evaluations:
            gain, load = evaluation.parameters["gain"], evaluation.context["load"]
            assert evaluation.outcome.metrics == {"error": gain, "peak": load}

    def test_one_that_does_not_come_to_be_loaded(self, make_function_study, monkeypatch):
        class Endless:
            def __reduce__(self):
                return time.sleep, (1000.0,)

            def __call__(self, parameters, context, seed):
                return {}

        monkeypatch.setattr("bo_tuner.backends.passed_function.LOADING", 0.5)
        with pytest.raises(bt.FunctionError, match=r"cannot be loaded .* its timeout of 0.5 s"):
            make_function_study().optimize(Endless(), timeout=0.1)

    def test_what_is_no_result_ends_the_call(self, make_function_study):
        with pytest.raises(bt.MetricsError, match="metric peak is missing; expected a number"):
            make_function_study().optimize(lambda *_: {"error": 1.0}, timeout=60.0)

    def test_a_function_that_is_not_found_in_its_process(
        self, make_function_study, tmp_path, monkeypatch
    ):
        (tmp_path / "moved.py").write_text("def f(parameters, context, seed):\n    return {}\n")
        with monkeypatch.context() as patched:
            patched.syspath_prepend(tmp_path)
            from moved import f
        # Here it is loaded already; nowhere else is it found.
        monkeypatch.setitem(sys.modules, "moved", sys.modules["moved"])
        with pytest.raises(bt.FunctionError, match="cannot be loaded in another process"):
            make_function_study().optimize(f, timeout=60.0)

    def test_times_that_cannot_be(self, make_function_study, function):
        study = make_function_study()
        for timeout in (0.0, -1.0, "1", float("nan"), 1e9):
            with pytest.raises(bt.StudyError, match="timeout: expected"):
                study.optimize(function, timeout=timeout)
            with pytest.raises(bt.StudyError, match="timeout: expected"):
                bt.certify(function, study, timeout=timeout)

    def test_the_process_ends_with_a_program_that_is_killed(self, make_function_study, tmp_path):
        (tmp_path / "study.yaml").write_text(make_function_study().to_yaml(), encoding="utf-8")
        mark = tmp_path / "mark"
        program = (
            "import os, sys, time\n"
            "import bo_tuner as bt\n"
            "mark = sys.argv[2]\n"
            "def hangs(parameters, context, seed):\n"
            "    open(mark, 'w').write(str(os.getpid()))\n"
            "    time.sleep(1000.0)\n"
            "bt.Study.from_yaml(sys.argv[1]).optimize(hangs, timeout=1000.0)\n"
        )
        command = [sys.executable, "-c", program, tmp_path / "study.yaml", mark]
        with subprocess.Popen(command, stderr=subprocess.DEVNULL) as run:
            wait_until(lambda: mark.exists() and mark.read_text(), "the function", run)
            run.kill()

        def has_ended():
            try:
                os.kill(int(mark.read_text()), 0)
            except ProcessLookupError:
                return True
            return False

        wait_until(has_ended, "its end")


def numbers(lines):
    """Those of the trials in the rows of a run."""
    first = (line.split()[0] for line in lines if line.strip())
    return [word for word in first if word.isdecimal()]


class TestProgress:
    def test_a_line_for_each_trial(self, make_function_study, function, tmp_path, capsys):
        make_function_study().optimize(function, tmp_path / "run")
        said = capsys.readouterr()
        lines = said.err.splitlines()
        assert lines[0] == f"run folder {tmp_path / 'run'}"
        assert numbers(lines) == list("0123")
        assert said.out == ""

    def test_of_a_run_that_goes_on_those_of_the_new_ones(
        self, make_function_study, function, tmp_path, capsys
    ):
        make_function_study().optimize(function, tmp_path / "run", progress=False)
        assert capsys.readouterr().err == ""
        make_function_study(6).optimize(function, tmp_path / "run")
        lines = capsys.readouterr().err.splitlines()
        assert numbers(lines) == ["4", "5"]

    def test_of_a_certificate(self, make_function_study, function, capsys):
        bt.certify(function, make_function_study(), {"gain": 0.2}, runs=80)
        assert "test runs at random: at most 80" in capsys.readouterr().err
        bt.certify(function, make_function_study(), {"gain": 0.2}, runs=80, progress=False)
        assert capsys.readouterr().err == ""
