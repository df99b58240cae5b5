"""Workers of a running Dask cluster: the answer is that of one process here."""

import os
import signal
import subprocess

import pytest
from commands import finish
from dask_cluster import Cluster, Host
from in_process import complaint
from waiting import wait_until
from waiting_runs import OBJECT, Runs, waiting_study

from bo_tuner.backends.workers import clusters
from bo_tuner.backends.workers.clusters import RunningCluster
from bo_tuner.backends.workers.identity import CORES, Needs, differences, identity
from bo_tuner.cli import tune
from bo_tuner.errors import BackendError


@pytest.fixture(scope="module")
def study(make_study):
    return waiting_study(make_study)


@pytest.fixture(scope="module")
def runs(tmp_path_factory, study):
    return Runs(tmp_path_factory.mktemp("runs"), study)


@pytest.fixture(scope="module")
def whole(runs):
    """Results of one process, with four trials planned at once."""
    return runs.run("whole", "--window", 4)


@pytest.fixture(scope="module")
def hosts():
    """Two hosts with addresses of their own, which share no more than what crosses the network."""
    made = []
    try:
        made += [Host(1), Host(2)]
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"no network namespaces: {error}")
    finally:
        if len(made) < 2:
            for host in made:
                host.close()
    yield made
    for host in made:
        host.close()


@pytest.fixture
def make_cluster(tmp_path):
    """Function that makes a cluster, without workers yet."""
    made = []

    def make(folder, *options, **settings):
        made.append(Cluster(folder, *options, **settings))
        return made[-1]

    yield make
    for cluster in made:
        cluster.close()


@pytest.fixture
def cluster(make_cluster, runs, hosts, whole):
    """A worker on each of two hosts."""
    runs.evaluations.unlink(missing_ok=True)
    cluster = make_cluster(runs.folder)
    cluster.workers = [cluster.worker(host=host) for host in hosts]
    cluster.wait_for(2)
    yield cluster
    for order in ("kill", "hold"):
        (runs.folder / order).unlink(missing_ok=True)


def networks(runs):
    return {network for _, network in runs.places}


def runs_known(dask_worker):
    """Runs that a worker has something of."""
    return [name for name in dask_worker.plugins if name.startswith("bo_tuner")]


@pytest.mark.slow
class TestTwoHosts:
    def test_the_answer_and_what_is_left(self, cluster, runs, whole):
        before = networks(runs)
        assert not before
        options = ("--scheduler", cluster.address, "--workers", 2, "--window", 4)
        assert runs.run("two", *options) == whole
        assert len(networks(runs)) == 2
        assert cluster.ask(runs_known) == [[], []]
        # The cluster is there for others, and the record does not depend on it.
        again = ("validate", runs.latest("two"), "--runs", 100)
        code, _, err = finish(runs.start(*again, "--scheduler", cluster.address))
        assert code in (0, 3), err
        assert cluster.ask(runs_known) == [[], []]

    def test_a_worker_that_dies_and_a_host_that_is_lost(self, cluster, runs, whole):
        (runs.folder / "hold").touch()
        options = ("--scheduler", cluster.address, "--workers", 2, "--window", 4)
        process = runs.begin("lost", *options)
        wait_until(lambda: len(networks(runs)) == 2, "both hosts", process)
        cluster.kill(cluster.workers[1])
        (runs.folder / "kill").touch()
        (runs.folder / "hold").unlink()
        code, _, err = finish(process)
        assert code == 0, err
        assert not (runs.folder / "kill").exists()
        assert runs.results("lost") == whole

    def test_a_scheduler_that_is_gone(self, cluster, runs, whole):
        (runs.folder / "hold").touch()
        process = runs.begin("gone", "--scheduler", cluster.address, "--workers", 2, "--window", 4)
        wait_until(lambda: len(networks(runs)) == 2, "both hosts", process)
        cluster.kill(cluster.scheduler)
        code, _, err = finish(process)
        (runs.folder / "hold").unlink()
        assert code == 1, err
        assert f"the scheduler {cluster.address} is gone" in err
        assert "--resume" in err
        code, _, err = finish(runs.start("tune", "--resume", "gone/latest"))
        assert code == 0, err
        assert runs.results("gone") == whole

    def test_a_scheduler_that_stands_still(self, cluster, runs, whole):
        """Ctrl-C ends the run all the same."""
        process = runs.begin("still", "--scheduler", cluster.address, "--workers", 2, "--window", 4)
        wait_until(lambda: runs.places, "an evaluation", process)
        os.kill(cluster.scheduler.pid, signal.SIGSTOP)
        process.send_signal(signal.SIGINT)
        code, _, err = finish(process)
        assert code == 130, err
        assert "interrupted by SIGINT; resume it with: tune --resume still/" in err
        code, _, err = finish(runs.start("tune", "--resume", "still/latest", "--workers", 1))
        assert code == 0, err
        assert runs.results("still") == whole

    def test_a_run_that_is_killed_leaves_nothing_on_the_workers(self, cluster, runs, whole):
        (runs.folder / "hold").touch()
        process = runs.begin("killed", "--scheduler", cluster.address, "--workers", 2,
                             "--window", 4)  # fmt: skip
        wait_until(lambda: len(networks(runs)) == 2, "both hosts", process)
        process.kill()
        finish(process)
        wait_until(lambda: cluster.ask(runs_known) == [[], []], "the end of the backends")
        (runs.folder / "hold").unlink()
        again = ("tune", "--resume", "killed/latest", "--scheduler", cluster.address)
        code, _, err = finish(runs.start(*again))
        assert code == 0, err
        assert runs.results("killed") == whole


@pytest.mark.slow
class TestInstallations:
    """A worker that has something else than the run is refused by name."""

    @pytest.fixture
    def refusal(self, make_cluster, runs, tmp_path, whole):
        """Function that returns what is said of a cluster with a worker that is odd."""

        def run(*options, path=()):
            cluster = make_cluster(runs.folder)
            cluster.worker(*options, path=path)
            cluster.wait_for(1)
            code, out, err = finish(
                runs.begin("refused", "--scheduler", cluster.address, "--workers", 1)
            )
            assert (code, out) == (2, ""), err
            assert not runs.latest("refused").exists()
            return err

        return run

    def test_other_code(self, refusal, tmp_path):
        (tmp_path / "waiting_axis.py").write_text(f"{OBJECT}# Changed.\n")
        assert "does not have what the run has: other code of waiting_axis;" in refusal(
            path=[tmp_path]
        )

    def test_another_version(self, refusal, tmp_path):
        metadata = tmp_path / "scipy-0.0.1.dist-info" / "METADATA"
        metadata.parent.mkdir()
        metadata.write_text("Metadata-Version: 2.1\nName: scipy\nVersion: 0.0.1\n")
        assert "does not have what the run has: scipy 0.0.1, expected " in refusal(path=[tmp_path])

    def test_none(self, refusal, tmp_path):
        (tmp_path / "bo_tuner.py").write_text("raise ImportError('not here')\n")
        line = refusal(path=[tmp_path])
        assert "does not have this version of bo_tuner" in line
        assert line.startswith("error: worker tcp://127.0.0.1:")

    def test_several_threads(self, refusal):
        assert "expected 1 thread, found 2; start it with --nthreads 1" in refusal("--nthreads", 2)


@pytest.mark.slow
def test_a_key_is_needed_where_there_is_one(make_cluster, runs, whole, tmp_path):
    """TLS as Dask has it: who has no certificate of the cluster's authority is not let in."""
    from distributed import Security

    security = Security.temporary()
    contents = {
        "ca.pem": security.tls_ca_file,
        "cert.pem": security.tls_client_cert,
        "key.pem": security.tls_client_key,
    }
    for name, content in contents.items():
        (tmp_path / name).write_text(content)
    files = {"ca-file": "ca.pem", "cert": "cert.pem", "key": "key.pem"}
    options = [word for key, name in files.items() for word in (f"--tls-{key}", tmp_path / name)]
    dask = {"DASK_DISTRIBUTED__COMM__TLS__CA_FILE": str(tmp_path / "ca.pem")}
    for role in ("CLIENT", "SCHEDULER", "WORKER"):
        for kind in ("CERT", "KEY"):
            file = str(tmp_path / f"{kind.lower()}.pem")
            dask[f"DASK_DISTRIBUTED__COMM__TLS__{role}__{kind}"] = file
    cluster = make_cluster(runs.folder, *map(str, options), scheme="tls")
    cluster.worker()
    new = ("--scheduler", cluster.address, "--workers", 1, "--window", 4)
    code, _, err = finish(runs.begin("tls", *new, env=dask))
    assert code == 0, err
    assert runs.results("tls") == whole
    # Who asks without the cipher is not answered.
    plain = ("--scheduler", cluster.address.replace("tls", "tcp"), "--workers", 1)
    code, _, err = finish(runs.begin("none", *plain))
    assert code == 2
    assert f"no Dask scheduler at {plain[1]}" in err


class TestOptions:
    @pytest.fixture
    def refused(self, runs, capsys, tmp_path):
        """Function that returns what is said of options."""

        def run(*options, backend="inprocess"):
            new = ("--study", runs.folder / "axis.yaml", "--backend", backend)
            line = complaint(tune, capsys, *new, "--output", tmp_path / "runs", *options)
            assert not [*tmp_path.glob("runs/*")]
            return line

        return run

    @pytest.mark.parametrize("address", ["host:8786", "tcp://host", "http://host:80", "tcp://:1"])
    def test_what_is_no_address(self, refused, address):
        line = refused("--scheduler", address, "--workers", 2)
        assert f"--scheduler: expected tcp://HOST:PORT or tls://HOST:PORT, found {address}" in line

    def test_how_many_is_to_be_said(self, refused):
        line = refused("--scheduler", "tcp://127.0.0.1:1")
        assert "--scheduler: expected --workers N, too" in line

    def test_running_nodes_are_not_where_its_workers_are(self, refused):
        line = refused(
            "--scheduler", "tcp://127.0.0.1:1", "--workers", 1, "--attach", backend="ros"
        )
        assert "--scheduler: expected nodes that the workers start, found --attach; leave" in line
        line = refused(
            "--scheduler", "tcp://127.0.0.1:1", "--workers", 2, "--benches", "1,2", backend="ros"
        )
        assert "expected nodes that the workers start, found --benches; leave --scheduler" in line

    def test_tls_without_keys(self, refused):
        line = refused("--scheduler", "tls://127.0.0.1:1", "--workers", 2)
        assert "no keys for tls://127.0.0.1:1; expected distributed.comm.tls.ca-file" in line

    def test_nobody_there(self, refused, monkeypatch):
        monkeypatch.setattr(clusters, "CONNECTING", 0.1)
        line = refused("--scheduler", "tcp://127.0.0.1:1", "--workers", 2)
        assert "no Dask scheduler at tcp://127.0.0.1:1: " in line


class Known:
    """In place of a connection: tells what its workers are."""

    status = "running"

    def __init__(self, **workers):
        self._workers = workers

    @property
    def scheduler(self):
        return self

    def sync(self, act, **options):
        return act(**options)

    def identity(self, n_workers):
        assert n_workers == -1
        return {"workers": {name: {"nthreads": 1, "host": "h"} for name in self._workers}}

    def run_on_scheduler(self, act, *arguments):
        return act(*arguments)

    def run(self, act, *arguments, on_error):
        assert on_error == "return"
        found = act(*arguments)
        return {name: found | changes for name, changes in self._workers.items()}


class TestChecks:
    NEEDS = Needs(("numpy",), ("bo_tuner",), "")

    def check(self, client, workers, *timed):
        cluster = RunningCluster("tcp://s:1", workers, self.NEEDS, timed)
        cluster._check(client, cluster._wait_for_workers(client, lambda: None), lambda: None)

    def test_too_few(self, monkeypatch):
        monkeypatch.setattr(clusters, "STARTING", 0.0)
        with pytest.raises(BackendError, match="expected 2 workers at tcp://s:1, found 1 after"):
            self.check(Known(a={}), 2)

    def test_measured_times_need_a_core_each_on_the_host(self):
        client = Known(a={CORES: "1"}, b={CORES: "1"})
        self.check(client, 2)
        self.check(client, 1, "return_time")
        with pytest.raises(BackendError, match=r"at most 1 workers on h, .* 2: .*\(return_time\)"):
            self.check(client, 2, "return_time")

    def test_what_differs_is_named(self):
        own = identity(("numpy",), ("bo_tuner",), "")
        assert differences(own, own | {CORES: "1000"}) == ""
        assert differences(own, own | {"numpy": "1"}).startswith("numpy 1, expected ")
        assert differences(own, own | {"code of bo_tuner": ""}) == "no code of bo_tuner"
        assert differences(own, {**own, "Python": "3.1"}).startswith("Python 3.1, expected 3.")

    def test_code_that_changes_is_not_that_which_runs(self, tmp_path):
        """A process of a cluster has imported what was there at its first run."""
        (tmp_path / "changing_code.py").write_text("a = 1\n")
        needs = ((), ("changing_code",), str(tmp_path))
        first = identity(*needs)
        (tmp_path / "changing_code.py").write_text("a = 2\n")
        assert identity(*needs) == first
