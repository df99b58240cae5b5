"""The command: the same tables whatever the jobs, a kill in between, or the machines."""

import json
import os
import re
import shutil
import signal
from functools import partial

import pytest
import yaml
from commands import Fork, finish, python_path, run, start
from in_process import complaint
from short_cuts import SHORT
from terminals import gone
from waiting import DEADLINE, wait_until

from bo_tuner.package_files import config_directory
from tuning_benchmark import command as command

EXPERIMENTS = config_directory("tuning_benchmark") / "experiments"


@pytest.fixture
def benchmark(tmp_path, experiment_file):
    """Function that starts the command on the valley, into a folder of its own."""
    started = []

    def begin(output, *arguments, experiment=experiment_file, environment=None, **streams):
        # Processes of several jobs come from a server of their own, which a fork would share.
        how = start if "--jobs" in arguments else Fork
        arguments = ("--experiment", experiment, "--output", tmp_path / output, *arguments)
        process = how(
            *arguments, folder=tmp_path, package="tuning_benchmark", env=environment, **streams
        )
        started.append(process)
        return process

    yield begin
    for process in started:
        process.kill()
        process.communicate()


@pytest.fixture
def refused(tmp_path, experiment_file, monkeypatch, capsys):
    """Function that runs the command in this process and returns its one line on stderr."""
    monkeypatch.chdir(tmp_path)
    return partial(complaint, command, capsys, "--experiment", experiment_file, "--output", "out")


@pytest.fixture(scope="module")
def whole(campaign_folder):
    """Folder and tables of a campaign that nothing disturbed."""
    code, tables, err = run(
        *("--experiment", "closed.yaml", "--output", "out"),
        folder=campaign_folder,
        package="tuning_benchmark",
    )
    assert code == 0, err
    return campaign_folder / "out", tables


def records_of(folder, name="closed"):
    lines = (folder / f"{name}.jsonl").read_text().splitlines()
    return {json.loads(line)["task"]: json.loads(line) for line in lines}


def wait_for_records(file, count, process):
    """Wait until so many tasks are on record, with the campaign still going on."""
    wait_until(
        lambda: file.exists() and file.read_bytes().count(b"\n") >= count, "records", process
    )


@pytest.mark.parametrize(("kind", "code"), [("full", 1), ("pipe", 141)])
def test_an_output_that_goes_away_leaves_the_records(benchmark, tmp_path, kind, code):
    # A task that has ended is on record before it is told of.
    with gone(kind) as output:
        process = benchmark("out", stderr=output)
    process.communicate(timeout=DEADLINE)
    assert process.returncode == code
    before = records_of(tmp_path / "out")
    assert before
    with gone(kind) as output:
        process = benchmark("out", "--page-only", stdout=output)
    _, err = process.communicate(timeout=DEADLINE)
    assert process.returncode == code
    assert "Traceback" not in err
    code_without, _, err = finish(benchmark("out", "--page-only"))
    assert code_without == 0, err
    assert records_of(tmp_path / "out") == before


def test_the_page_has_the_cases(whole):
    folder, tables = whole
    assert "A valley" in tables
    assert "| A valley | I |" in (folder / "results.md").read_text()


def test_published_records_make_the_same_tables_and_are_linked(benchmark, whole, tmp_path):
    shutil.copy(whole[0] / "closed.jsonl", tmp_path / "closed.jsonl")
    fronts = {
        "runs": 2,
        "provenance": {"commit": "c0ffee", "machine": "m", "versions": []},
        "problems": {},
    }
    (tmp_path / "fronts.json").write_text(json.dumps(fronts))
    published = tmp_path / "published"
    given = ("--page-only", "--records", tmp_path, "--publish", published)
    code, tables, err = finish(benchmark("out", *given))
    assert (code, tables) == (0, whole[1]), err
    page = (tmp_path / "out" / "results.md").read_text()
    assert "(../published/closed.jsonl)" in page
    assert "## Pareto fronts" in page
    assert "(../published/fronts.json)" in page
    code, tables, err = finish(benchmark("again", "--page-only", "--records", published))
    assert (code, tables) == (0, whole[1]), err


def test_tables_are_the_same_with_two_jobs_and_after_a_kill(benchmark, whole, tmp_path):
    _, tables = whole
    killed = benchmark("two", "--jobs", "2")
    wait_for_records(tmp_path / "two" / "closed.jsonl", 1, killed)
    os.kill(killed.pid, signal.SIGKILL)
    killed.communicate()
    before = records_of(tmp_path / "two")
    assert 0 < len(before) < 8
    with (tmp_path / "two" / "closed.jsonl").open("a") as file:
        file.write('{"task": "run/valley/IV')
    code, resumed, err = finish(benchmark("two", "--jobs", "2"))
    assert code == 0, err
    assert f"{len(before)} of 8 tasks are on record" in err
    assert resumed == tables
    after = records_of(tmp_path / "two")
    assert {name: after[name] for name in before} == before


@pytest.mark.parametrize(
    ("jobs", "signum"), [("1", signal.SIGINT), ("2", signal.SIGINT), ("2", signal.SIGTERM)]
)
def test_a_signal_keeps_what_is_done(benchmark, tmp_path, jobs, signum):
    process = benchmark("out", "--jobs", jobs)
    wait_for_records(tmp_path / "out" / "closed.jsonl", 1, process)
    process.send_signal(signum)
    code, out, err = finish(process)
    assert code == 128 + signum
    assert out == ""
    assert "the same command resumes" in err
    assert records_of(tmp_path / "out")


def test_ctrl_c_in_compiled_code_is_one_line(tmp_path, experiment_file):
    """The interpreter ends while the task still runs."""
    experiment_file.write_text(
        experiment_file.read_text().replace("runs: 2", "runs: 1").replace(":Draws", ":Endless")
    )
    solving = tmp_path / "solving"
    process = start(
        *("--experiment", experiment_file, "--output", "out"),
        folder=tmp_path,
        package="tuning_benchmark",
        env={"VALLEY_ENDLESS": str(solving)},
    )
    wait_until(solving.exists, "the optimizer", process)
    process.send_signal(signal.SIGINT)
    code, out, err = finish(process)
    assert (code, out) == (130, "")
    assert err.splitlines()[-2:] == [
        "finished tasks are on record in out; the same command resumes",
        "interrupted by SIGINT",
    ]


def test_a_task_that_raises_is_a_failed_run_with_its_reason(benchmark, tmp_path, experiment_file):
    text = experiment_file.read_text()
    experiment_file.write_text(
        text.replace("runs: 2", "runs: 1").replace('"valley:Draws"}', '"valley:Broken"}')
    )
    code, _, err = finish(benchmark("out"))
    assert code == 1
    assert "run/valley/lent/1 failed: RuntimeError: out of ideas" in err
    page = (tmp_path / "out" / "results.md").read_text()
    assert "- run/valley/lent/1: RuntimeError: out of ideas" in page
    assert records_of(tmp_path / "out")["run/valley/draws/1"]["failed"] == ""


def test_a_failed_task_runs_again(benchmark, tmp_path, experiment_file):
    text = experiment_file.read_text().replace("runs: 2", "runs: 1")
    experiment_file.write_text(text.replace('"valley:Draws"}', '"valley:Unsteady"}'))
    unsteady = tmp_path / "unsteady"
    unsteady.write_text("")
    environment = {"VALLEY_UNSTEADY": str(unsteady)}
    code, _, err = finish(benchmark("out", environment=environment))
    assert code == 1
    assert "failed: OSError: unsteady" in err
    unsteady.unlink()
    code, _, err = finish(benchmark("out", environment=environment))
    assert code == 0, err
    records = records_of(tmp_path / "out")
    assert records["run/valley/lent/1"]["failed"] == ""


def test_a_process_with_other_code_does_no_task(benchmark, tmp_path, experiment_file):
    """As a worker elsewhere, or one that starts after an edit."""
    text = experiment_file.read_text()
    experiment_file.write_text(text.replace("runs: 2", "runs: 1").replace("valley:", "edited:"))
    (tmp_path / "edited.py").write_text(
        "import pathlib\nfrom valley import Draws, Judge\n"
        "pathlib.Path(__file__).write_text(pathlib.Path(__file__).read_text() + '# edited\\n')\n"
    )
    code, _, err = finish(benchmark("out", "--jobs", "2"))
    assert code == 1
    assert "has another version of the code" in err.splitlines()[-1]
    assert (tmp_path / "out" / "closed.jsonl").read_text() == ""


def test_records_of_another_version_are_not_mixed(refused, tmp_path):
    (tmp_path / "out").mkdir()
    record = {"task": "run/valley/IV/1", "version": "older"}
    (tmp_path / "out" / "closed.jsonl").write_text(json.dumps(record) + "\n")
    line = refused()
    assert "closed.jsonl: holds run/valley/IV/1 of another version of the code or the exp" in line
    assert "older, now" in line


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--jobs", "0"], "error: --jobs: expected at least 1, found 0"),
        (["--cluster", "localhost"], "error: --cluster: expected dask://host:port or tcp://"),
        (["--page-only"], "error: no run of closed is on record"),
        (
            ["--experiment", "none"],
            "error: unknown experiment 'none'; shipped are boundary, choices, closed_form, ",
        ),
        (["--experiment", "closed.yaml"], "error: --experiment: two are named closed, and would"),
        (["--records", "/proc/none"], "error: .*/proc/none/closed.jsonl: cannot be written"),
    ],
)
def test_mistakes_are_one_line_and_exit_code_2(refused, arguments, message):
    line = refused(*arguments)
    assert re.match(message, line), line


def test_an_optimizer_that_is_not_there_is_said_before_any_task(refused, tmp_path, experiment_file):
    experiment_file.write_text(experiment_file.read_text().replace("valley:Draws", "valleys:Draws"))
    assert "cannot load valleys:Draws: ModuleNotFoundError" in refused()
    assert not (tmp_path / "out").exists()


def test_a_page_of_what_is_on_record_so_far(benchmark, whole, tmp_path):
    done = (whole[0] / "closed.jsonl").read_text().splitlines(keepends=True)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "closed.jsonl").write_text("".join(done[:5]))
    code, tables, err = finish(benchmark("out", "--page-only"))
    assert code == 0, err
    assert "1 of 1" in tables
    page = (tmp_path / "out" / "results.md").read_text()
    assert "| A valley | I | " in page
    assert "(closed.jsonl)" in page
    assert "**Not on record yet**: 1 of 2 runs of valley." in page

    # As published records are, to those who have another version of the code or of a library.
    records = tmp_path / "out" / "closed.jsonl"
    records.write_text(re.sub(r'"version":\s*"\w+"', '"version": "older"', records.read_text()))
    code, again, err = finish(benchmark("out", "--page-only"))
    assert code == 0, err
    assert again == tables
    code, _, err = finish(benchmark("out"))
    assert code == 2
    assert "of another version of the code" in err


@pytest.mark.slow
def test_a_dask_cluster_of_two_processes_gives_the_same_tables(benchmark, whole, tmp_path):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0",
        env={"PYTHONPATH": python_path(tmp_path)},
    ) as cluster:  # fmt: skip
        address = cluster.scheduler_address.replace("tcp://", "dask://")
        code, there, err = finish(benchmark("there", "--cluster", address))
    assert code == 0, err
    assert there == whole[1]


@pytest.mark.slow
def test_workers_of_several_threads_are_refused(benchmark):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=True, dashboard_address="127.0.0.1:0"
    ) as cluster:
        code, out, err = finish(benchmark("out", "--cluster", cluster.scheduler_address))
    assert (code, out) == (2, "")
    assert "expected workers of one thread" in err.splitlines()[-1]


@pytest.mark.slow
def test_a_cluster_that_does_not_answer_is_one_line(benchmark):
    pytest.importorskip("distributed")
    code, out, err = finish(benchmark("out", "--cluster", "tcp://127.0.0.1:9"))
    assert (code, out) == (2, "")
    assert "no Dask scheduler answers there" in err.splitlines()[-1]


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_small_campaign_of_the_milling_axis(benchmark, tmp_path):
    experiment = yaml.safe_load((EXPERIMENTS / "small.yaml").read_text())
    # Judging takes most of the time: little noise, short cuts, and wide limits, with which no
    # program of theirs needs more than a matrix product.
    (tmp_path / "quick.py").write_text(
        "from tuning_benchmark.milling import judge\n"
        "judge.NOISE, judge.MORE_NOISE = 2, 4\n"
        "Judge = judge.Judge\n"
    )
    experiment["judge"] = "quick:Judge"
    experiment["cases"]["benchmark"]["changes"] = {
        "nodes.plant.parameters": SHORT,
        "nodes.controller.parameters": {"input_lower": -100.0, "input_upper": 100.0},
    }
    (tmp_path / "small.yaml").write_text(yaml.safe_dump(experiment))
    code, tables, err = finish(benchmark("out", experiment=tmp_path / "small.yaml"), 500.0)
    assert code == 0, err
    records = records_of(tmp_path / "out", "small")
    assert len(records) == 6
    assert not any(record["failed"] for record in records.values())
    for name in ("I", "II", "III", "IV", "V", "boundary"):
        assert f"| {name} |" in tables
