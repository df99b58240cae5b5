"""Workers over ROS: each has nodes of its own, in a domain of its own, or a bench of its own."""

import contextlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from bag_readers import with_rosbags
from commands import Fork, finish
from dask_cluster import Cluster, Host
from example_nodes import UNCHANGED, start_script
from reaper import MARK
from ros_processes import claim_domain
from std_msgs.msg import Float64
from std_srvs.srv import SetBool
from waiting import wait_until

from bo_tuner.backends.factory import make_backend
from bo_tuner.backends.workers.workers import Bench, Workers
from bo_tuner.errors import BackendError
from bo_tuner.recording.retention import custom_data, is_bag, made_bags
from bo_tuner.replay.recompute import differing, recompute
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.storage.record import read_run
from bo_tuner.storage.session_options import options_of
from bo_tuner.study.study_file import (
    load_study,
    study_from_mapping,
    study_to_mapping,
    study_to_yaml,
)
from bo_tuner.trials import Evaluation, EvaluationState, Stage

pytestmark = pytest.mark.ros

TRIAL = {"kp": 2.0, "ki": 0.0, "kd": 0.375}


def study(budget=None, **nodes):
    """The study of the example, whose nodes are started with the number of the worker."""
    mapping = study_to_mapping(load_study(str(UNCHANGED / "study.yaml")))
    mapping["budget"] |= budget or {}
    for signal_of in mapping["signals"].values():
        signal_of["largest_gap"] = 5.0
    del mapping["run"]["abort_when"]
    mapping["nodes"] = {
        name: {
            "node": name,
            "command": f"'{sys.executable}' '{UNCHANGED / f'{name}_node.py'}'",
            "env": {"BENCH": "bench-{worker}"},
        }
        for name in ("pid", "motor")
    } | nodes
    return study_from_mapping(mapping)


@pytest.fixture
def opened(tmp_path):
    """Function that opens two workers of a study."""
    backends = []

    def make(of, workers=Workers(2), attach=False):  # noqa: B008
        backends.append(
            make_backend("ros", of, tmp_path, attach=attach, ros_arguments=[],
                         interrupted=lambda: None, workers=workers)
        )  # fmt: skip
        backends[-1].open()
        return backends[-1]

    yield make
    for backend in backends:
        backend.close()


def environments():
    """Of the nodes of the example that this process has run: bench and domain, by process."""
    found, own = {}, os.environ[MARK].encode()
    for process in Path("/proc").iterdir():
        if not process.name.isdigit():
            continue
        try:
            command = (process / "cmdline").read_bytes()
            variables = (process / "environ").read_bytes().split(b"\0")
        except OSError:
            continue
        values = dict(v.split(b"=", 1) for v in variables if b"=" in v)
        ours = values.get(MARK.encode()) == own
        if ours and str(UNCHANGED).encode() in command and b"BENCH" in values:
            found[process.name] = (values[b"BENCH"], values[b"ROS_DOMAIN_ID"])
    return found


def test_each_has_its_nodes_its_domain_and_its_log(opened, tmp_path):
    backend = opened(study())
    nodes = environments().values()
    # Two nodes of each worker are in one domain, in which those of the other are not.
    assert sorted(bench for bench, _ in nodes) == [b"bench-1"] * 2 + [b"bench-2"] * 2
    assert len(set(nodes)) == 2
    assert len({domain for _, domain in nodes}) == 2
    assert all((tmp_path / f"worker-{number}" / "motor.log").exists() for number in (1, 2))
    planned = [Evaluation(0, k, Stage.DRAWN, TRIAL, {}, k) for k in range(3)]
    done = list(backend.run(planned))
    while len(done) < len(planned):
        done += backend.run([])
    assert {evaluation.index for evaluation in done} == {0, 1, 2}
    assert all(e.outcome.state is EvaluationState.COMPLETE for e in done), done
    assert backend.park() == []
    backend.close()
    wait_until(lambda: not environments(), "the end of the nodes")


def test_one_whose_nodes_do_not_start_is_named(opened):
    pid = {"node": "pid", "command": "no_such_program --of {worker}"}
    with pytest.raises(BackendError, match=r"worker 1 of 2 cannot be started: .*no_such_program"):
        opened(study(pid=pid))
    assert not environments()


SHORT = {"trials": 5, "initial_trials": 3, "drawn_contexts": 1, "validation_draws": 3}


@pytest.fixture
def runs_here(tmp_path):
    """Function that runs a command to its end in the folder of a study; returns what it says."""

    def run(*arguments):
        code, out, err = finish(Fork(*arguments, folder=tmp_path))
        assert code in (0, 3), err
        return out + err

    return run


def incomplete(folder):
    """Outcomes on record of evaluations that were lost or have failed."""
    outcomes = [evaluation.outcome for evaluation in read_run(folder).evaluations]
    assert outcomes
    return [outcome for outcome in outcomes if not outcome.complete]


@pytest.mark.slow
def test_a_whole_run_with_a_pause_and_its_certificate(empty_domain, make_peer, tmp_path, runs_here):
    (tmp_path / "study.yaml").write_text(study_to_yaml(study(budget=SHORT)))
    peer = make_peer()
    tune = Fork(
        "tune", "--study", "study.yaml", "--workers", "2", "--record", "all", folder=tmp_path
    )
    try:
        # The run is seen in the domain of the environment, and its nodes are not.
        assert peer.call(SetBool, "tuner/pause", SetBool.Request(data=True)).success
        assert peer.call(SetBool, "tuner/pause", SetBool.Request(data=False)).success
        assert not [name for name in peer.node.get_node_names() if name in ("pid", "motor")]
        code, _, err = finish(tune)
    finally:
        tune.kill()
    assert code in (0, 3), err
    run = tmp_path / "runs" / "latest"
    assert not incomplete(run)
    assert all((run / "log" / f"worker-{number}" / "motor.log").exists() for number in (1, 2))
    assert not environments()
    # The metrics of every run come out of the bags again, whichever worker has heard it.
    record = read_run(run)
    again = list(recompute(record, record.study))
    assert len(again) == len(record.evaluations)
    assert not any(differing(record, record.study, recomputed) for recomputed in again)
    for bag in filter(is_bag, made_bags(run / "bags")):
        # A run takes 2 s, and the motor publishes at 100 Hz.
        states = [topic for topic, *_ in with_rosbags(bag) if topic == "/joint_states"]
        assert len(states) > 100 * sum(item.run.bag == bag.name for item in again)
        assert custom_data(bag)["lost_messages"] == "0"
    assert "certificate: " in runs_here("validate", "latest", "--runs", "80", "--workers", "2")
    assert not environments()


@pytest.fixture
def start_bench(tmp_path):
    """Function that starts the nodes of a bench: its name, ROS arguments, and the domain."""
    started = []

    def start(name, *arguments, domain):
        env = os.environ | {"ROS_DOMAIN_ID": str(domain)}
        for node in ("motor", "pid"):
            script, log = UNCHANGED / f"{node}_node.py", tmp_path / f"{name}-{node}.txt"
            started.append(start_script(script, log, "--ros-args", *arguments, env=env))

    yield start
    for process in started:
        process.kill()
        process.wait()


def bench_study(**changes):
    """The study of the example with names that are relative to a namespace."""
    text = study_to_yaml(study(**changes)).replace("topic: /", "topic: ")
    return text.replace("service: /motor", "service: motor")


@pytest.mark.slow
def test_benches_in_namespaces(empty_domain, start_bench, make_peer, tmp_path, runs_here):
    """A run, resumed on the same, and each bench is left as it was."""
    (tmp_path / "study.yaml").write_text(bench_study(budget=SHORT))
    names = ("/left", "/right")
    for number, name in enumerate(names):
        place = ("-r", f"__ns:={name}", "-p", f"kd:={0.25 + 0.125 * number}")
        start_bench(name[1:], *place, domain=empty_domain)
    peers = [make_peer(name) for name in names]
    setpoints = [peer.record(Float64, "setpoint") for peer in peers]
    for peer in peers:
        peer.get_parameters("pid", ["kp"])
    runs_here("tune", "--study", "study.yaml", "--benches", "/left,/right")
    assert not incomplete(tmp_path / "runs" / "latest")
    for peer, heard, kd in zip(peers, setpoints, (0.25, 0.375), strict=True):
        # Each was at work.
        peer.spin_until(lambda heard=heard: any(m.data == 1.0 for m in heard), "a run")
        assert peer.get_parameters("pid", ["kd"]) == [kd]
        heard.clear()
    # Those on record are taken.
    runs_here("tune", "--resume", "latest", "--trials", "7")
    (*_, last) = read_journal(tmp_path / "runs" / "latest" / "journal.sqlite").sessions
    options = options_of(last)
    assert (options.benches, options.workers) == (("/left", "/right"), 2)
    for peer, heard in zip(peers, setpoints, strict=True):
        peer.spin_until(lambda heard=heard: any(m.data == 1.0 for m in heard), "a run")


def test_benches_in_domains(start_bench, opened, monkeypatch):
    claims = [claim_domain(os.environ.get("PYTEST_XDIST_WORKER", "gw")) for _ in range(2)]
    benches = []
    for domain, _ in claims:
        start_bench(str(domain), domain=domain)
        benches.append(Bench(str(domain), domain, "/"))
    backend = opened(study(), workers=Workers(2, benches=tuple(benches)), attach=True)
    planned = [Evaluation(0, k, Stage.DRAWN, TRIAL, {}, k) for k in range(2)]
    done = list(backend.run(planned))
    done += [] if len(done) == len(planned) else backend.run([])
    assert all(e.outcome.state is EvaluationState.COMPLETE for e in done), done
    assert {e.index for e in done} == {0, 1}
    backend.close()
    for _, lock in claims:
        lock.close()


@pytest.fixture
def cluster(tmp_path):
    """A scheduler, and as many hosts as there may be of each test."""
    made = Cluster(tmp_path)
    yield made
    made.close()


@pytest.fixture
def hosts():
    """Two hosts with addresses of their own."""
    made = []
    try:
        made += [Host(1)]
        made += [Host(2)]
        yield made
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"no network namespaces: {error}")
    finally:
        for host in made:
            host.close()


@pytest.mark.slow
def test_nodes_on_two_hosts(cluster, hosts, empty_domain, tmp_path, runs_here):
    (tmp_path / "study.yaml").write_text(study_to_yaml(study(budget=SHORT)))
    folders = [tmp_path / f"host-{number}" for number in (1, 2)]
    for host, folder in zip(hosts, folders, strict=True):
        cluster.worker("--local-directory", folder, host=host)
    cluster.wait_for(2)
    options = ("--scheduler", cluster.address, "--workers", "2")
    said = runs_here("tune", "--study", "study.yaml", *options)
    assert f"2 workers of the cluster {cluster.address}" in said
    assert not incomplete(tmp_path / "runs" / "latest")
    # The best trial is in a bag here, and what has validated it on each host.
    names = {bag.name for bag in made_bags(tmp_path / "runs" / "latest" / "bags") if is_bag(bag)}
    assert names >= {"validation", "validation_part2"}
    assert any(name.startswith("trial_") for name in names)
    # Each host has what its own nodes have printed.
    for folder in folders:
        assert len(list(folder.glob("bo_tuner/*/worker-*/motor.log"))) == 1
    assert not environments()


@pytest.mark.slow
class TestOddWorkers:
    """A worker on which the nodes cannot be started is named."""

    def refusal(self, cluster, tmp_path, *options, text, then=lambda: None, **variables):
        (tmp_path / "study.yaml").write_text(text)
        cluster.worker(*options, **variables)
        cluster.wait_for(1)
        then()
        new = ("--study", "study.yaml", "--scheduler", cluster.address, "--workers", "1")
        code, out, err = finish(Fork("tune", *new, folder=tmp_path))
        assert (code, out) == (2, ""), err
        assert err.startswith("error: worker tcp://127.0.0.1:"), err
        assert not environments()
        return err

    def test_without_the_program(self, cluster, tmp_path, empty_domain, monkeypatch):
        programs = tmp_path / "programs"
        programs.mkdir()
        (programs / "only_here").symlink_to(shutil.which("true"))
        path = os.environ["PATH"]
        monkeypatch.setenv("PATH", f"{programs}:{path}")
        text = study_to_yaml(study(pid={"node": "pid", "command": "only_here --of {worker}"}))
        line = self.refusal(cluster, tmp_path, text=text, PATH=path)
        assert "there is no program only_here" in line

    def test_with_a_full_disk(self, cluster, tmp_path, empty_domain):
        disk = tmp_path / "disk"
        disk.mkdir()
        mount = ["mount", "-t", "tmpfs", "-o", "nr_inodes=50", "tmpfs", disk]
        if subprocess.run(mount, capture_output=True, check=False).returncode:
            pytest.skip("no disk of its own can be made")

        def fill():
            # Dask has room for what it has written, and all else is taken.
            with contextlib.suppress(OSError):
                for number in range(50):
                    (disk / f"{number}").touch()

        try:
            line = self.refusal(
                cluster, tmp_path, "--local-directory", disk,
                text=study_to_yaml(study()), then=fill,
            )  # fmt: skip
            assert "No space left on device" in line
        finally:
            cluster.close()
            subprocess.run(["umount", "--lazy", disk], check=True)
