"""Several evaluations at once: the answer is that of one after the other, whatever happens."""

import os
import signal

import pytest
import yaml
from commands import finish
from in_process import complaint
from live_run import Page
from waiting import DEADLINE, wait_until
from waiting_runs import Runs, waiting_study

from bo_tuner.backends.workers import limits
from bo_tuner.backends.workers.workers import Workers
from bo_tuner.cli import tune, validate
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.storage.session_options import options_of
from bo_tuner.study.study_file import study_to_mapping, study_to_yaml


@pytest.fixture(scope="module")
def study(make_study):
    return waiting_study(make_study)


@pytest.fixture(scope="module")
def shared(tmp_path_factory, study):
    return Runs(tmp_path_factory.mktemp("shared"), study)


@pytest.fixture(scope="module")
def whole(shared):
    """Results of one worker, with four trials planned at once."""
    return shared.run("whole", "--workers", 1, "--window", 4)


@pytest.fixture
def runs(shared, whole):
    """In the same folder, which a study has on record."""
    shared.evaluations.unlink()
    yield shared
    for order in ("kill", "hold"):
        (shared.folder / order).unlink(missing_ok=True)


@pytest.fixture
def alone(tmp_path, study):
    """In a folder of its own, in which everything may be changed."""
    return Runs(tmp_path, study)


class TestAnswer:
    def test_it_does_not_depend_on_how_many_there_are_or_who_is_faster(self, runs, whole):
        assert runs.run("several", "--workers", 3, "--window", 4) == whole
        assert len({pid for pid, _ in runs.places}) == 3

    def test_it_depends_on_the_window(self, shared, whole):
        assert shared.run("one", "--window", 1)[2] != whole[2]

    def test_the_window_is_as_wide_as_there_are_workers_and_stays(self, runs, capsys):
        runs.run("new", "--workers", 2, "--trials", 3)
        (session,) = read_journal(runs.latest("new") / "journal.sqlite").sessions
        assert (options_of(session).workers, options_of(session).window) == (2, 2)
        line = complaint(tune, capsys, "--resume", runs.latest("new"), "--window", 3, "--trials", 4)
        assert "--window: expected 2, by which the trials of the run were planned" in line

    def test_a_certificate(self, shared, whole):
        """Contexts, bounds and verdict, in the file that others read."""
        for workers in (1, 2):
            again = ("validate", shared.latest("whole"), "--workers", workers, "--window", 2)
            code, _, err = finish(shared.start(*again, "--runs", 300))
            assert code in (0, 3), err
        certificates = sorted((shared.latest("whole") / "certificates").glob("*.csv"))
        assert len(certificates) >= 2
        # Each has fresh draws: as many were run, for the same reason.
        first, second = (path.read_text().splitlines() for path in certificates[:2])
        assert first[0] == second[0]


class TestFaults:
    @pytest.mark.parametrize("workers", [2, pytest.param(4, marks=pytest.mark.slow)])
    def test_what_a_worker_had_that_died_is_run_again(self, runs, whole, workers):
        (runs.folder / "kill").touch()
        assert runs.run("killed", "--workers", workers, "--window", 4) == whole
        assert not (runs.folder / "kill").exists()

    def test_a_run_that_was_killed_goes_on(self, runs, shared, whole):
        (runs.folder / "hold").touch()
        process = runs.begin("killed", "--workers", 2, "--window", 4)
        wait_until(lambda: runs.evaluations.exists(), "an evaluation", process)
        process.kill()
        finish(process)
        (runs.folder / "hold").unlink()
        code, _, err = finish(runs.start("tune", "--resume", "killed/latest"))
        assert code == 0, err
        assert runs.results("killed") == whole

    def test_ctrl_c_ends_the_workers(self, runs, whole):
        process = runs.begin("ended", "--workers", 2, "--window", 4)
        wait_until(lambda: len(runs.places) >= 6, "evaluations", process)
        pids = {int(pid) for pid, _ in runs.places}
        process.send_signal(signal.SIGINT)
        code, _, err = finish(process)
        assert code == 128 + signal.SIGINT, err
        assert "--resume" in err
        assert not any(alive(pid) for pid in pids)
        code, _, err = finish(runs.start("tune", "--resume", "ended/latest", "--workers", 1))
        assert code == 0, err
        assert runs.results("ended") == whole

    @pytest.mark.slow
    def test_a_pause_and_a_kill_in_it(self, runs, whole):
        """Nothing is evaluated in the pause, and nothing is lost by it."""
        said = runs.folder / "said.txt"
        with said.open("w") as file:
            process = runs.begin(
                "paused", "--workers", 4, "--web", "--web-control", stdout=file, stderr=file
            )
        wait_until(lambda: len(runs.places) >= 3, "evaluations", process, said.read_text)
        page = Page(process, said)
        assert page.request("pause")[0] == 202
        page.state_when(lambda state, _: state["now"]["paused"])
        in_pause = len(runs.places)
        assert page.request("continue")[0] == 202
        wait_until(lambda: len(runs.places) > in_pause, "evaluations", process, said.read_text)
        assert page.request("pause")[0] == 202
        page.state_when(lambda state, _: state["now"]["paused"])
        in_pause = len(runs.places)
        process.kill()
        process.wait(DEADLINE)
        assert len(runs.places) == in_pause
        code, _, err = finish(runs.start("tune", "--resume", "paused/latest"))
        assert code == 0, err
        assert runs.results("paused") == whole

    def test_one_that_cannot_be_started_is_named(self, alone):
        (alone.folder / "waiting_axis.py").write_text("raise OSError('no such bus')\n")
        code, out, err = finish(alone.begin("none", "--workers", 2))
        assert (code, out) == (2, ""), err
        assert err.startswith("error: worker 1 of 2 cannot be started: nodes.axis.object: ")
        assert "no such bus" in err


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


class TestRefusals:
    @pytest.fixture
    def refused(self, alone, capsys, monkeypatch):
        """Function that returns what is said of options for a study on ROS nodes."""
        monkeypatch.setattr(limits, "cores", lambda: 2)

        def run(*options, study="axis.yaml", backend="ros"):
            named = study if study == "benchmark" else alone.folder / study
            new = ("--study", named, "--backend", backend, "--output", alone.folder / "runs")
            line = complaint(tune, capsys, *new, *options)
            assert not (alone.folder / "runs").exists()
            return line

        return run

    @pytest.mark.parametrize(
        ("options", "said"),
        [
            (("--workers", 0), "--workers: expected at least 1, found 0"),
            (("--workers", 101), "--workers: expected at most 100, found 101"),
            (("--window", 0), "--window: expected at least 1, found 0"),
            (("--workers", 2, "--attach"), "--workers: expected 1 with --attach, found 2"),
            (
                ("--scheduler", "", "--workers", 2),
                "tcp://HOST:PORT or tls://HOST:PORT, found nothing",
            ),
        ],
    )
    def test_options(self, refused, options, said):
        assert said in refused(*options)

    @pytest.mark.parametrize(
        ("options", "said"),
        [
            (
                ("--benches", "left"),
                "or namespaces such as /left, separated by commas, found 'left'",
            ),
            (("--benches", "233"), "expected ROS domains from 0 to 232, or namespaces"),
            (("--benches", ""), "separated by commas, found ''"),
            (("--benches", "1,"), "separated by commas, found ''"),
            (("--benches", "1,2,1"), "--benches: expected each once, found 1 again"),
            (("--benches", "/a,/a/"), "--benches: expected each once, found /a/ again"),
            (("--benches", "1,2", "--workers", 3), "--workers: expected 2, one for each of"),
            (("--benches", "1", "--no-attach"), "--benches: expected nodes that run, found"),
            (
                ("--benches", "/a", "--ros-args", "-r", "__ns:=/x"),
                "expected namespaces in full, such as /x/a, and none in --ros-args",
            ),
        ],
    )
    def test_benches(self, refused, options, said):
        assert said in refused(*options)

    def test_benches_are_of_nodes(self, refused):
        line = refused("--benches", "1,2", backend="inprocess")
        assert "--benches needs --backend ros" in line

    def test_measured_times_beside_more_workers_than_cores(self, refused):
        line = refused("--workers", 3, study="benchmark")
        assert "expected at most 2, the number of cores, found 3" in line
        assert "(return_time)" in line

    @pytest.mark.parametrize(
        ("node", "port"),
        [
            ({"command": "sim --port 5760"}, "5760"),
            ({"command": "sim --url=udp:127.0.0.1:14550"}, "14550"),
            ({"launch": "robot sim.launch.py port:=9090"}, "9090"),
            ({"command": "sim", "env": {"SIM_PORT": "5760"}}, "5760"),
        ],
    )
    def test_a_port_that_all_would_want(self, refused, alone, make_study, node, port):
        axis = {"node": "axis", "result": "~/cut_result"} | node
        file = alone.folder / "port.yaml"
        file.write_text(study_to_yaml(make_study(nodes={"axis": axis})))
        line = refused("--workers", 2, study="port.yaml")
        assert f"nodes.axis: port {port} would be the same for all 2 workers" in line
        assert "{worker}" in line

    @pytest.mark.parametrize(
        "node",
        [
            {"command": "sim --port 576{worker}"},
            {"command": "sim --rate 5000"},
            {"command": "sim", "env": {"SIM_PORT": "576{worker}", "STEPS": "20000"}},
        ],
    )
    def test_what_is_no_port_of_all(self, make_study, node):
        study = make_study(nodes={"axis": {"node": "axis", "result": "~/cut_result"} | node})
        assert limits.problem_of_workers(study, "ros", Workers(2), attach=False) == ""

    def test_the_study_says_how_many(self, alone, study, refused):
        budget = {"trials": 5, "initial_trials": 3, "workers": 2}
        mapping = study_to_mapping(study)
        (alone.folder / "two.yaml").write_text(yaml.safe_dump(mapping | {"budget": budget}))
        line = refused("--attach", study="two.yaml")
        assert "expected 1 with --attach, found 2" in line
        none = mapping | {"budget": budget | {"workers": 0}}
        (alone.folder / "none.yaml").write_text(yaml.safe_dump(none))
        assert "budget.workers" in refused(study="none.yaml")

    def test_validate_on_running_nodes(self, shared, whole, capsys):
        options = ("--backend", "ros", "--attach", "--workers", 2)
        line = complaint(validate, capsys, shared.latest("whole"), *options)
        assert "--workers: expected 1 with --attach, found 2" in line


def test_without_dask(alone):
    """It is an extra: who wants one worker does not need it."""
    (alone.folder / "distributed.py").write_text("raise ImportError('no', name='distributed')\n")
    assert alone.run("one")
    code, _, err = finish(alone.begin("two", "--workers", 2))
    assert code == 2
    assert "pip install 'bo_tuner[workers]'" in err
