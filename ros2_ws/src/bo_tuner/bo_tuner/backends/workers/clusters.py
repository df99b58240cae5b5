"""Connections to Dask: processes of this machine that are started, or a cluster that runs."""

import contextlib
import multiprocessing
import time
from collections import Counter
from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from bo_tuner.backends.workers.identity import CORES, Needs, differences, identity
from bo_tuner.errors import BackendError
from bo_tuner.interruption import LOOK_AROUND, waited_for
from bo_tuner.processor_load import PROC

if TYPE_CHECKING:
    from distributed import Client

STARTING = 60.0
"""Time [s] that the processes of the workers have to come up."""
CONNECTING = 10.0
"""Time [s] that a scheduler has to answer."""
DEATHS = 3
"""Worker processes on this machine that may end while they run the same evaluation; then it is
lost."""
LETTING_GO = 10.0
"""Time [s] in which the processes of a run are to end, or connections to a cluster."""
CRITICAL = 50
"""Level of what Dask may log: what matters is told by the run."""
OWN: Mapping[str, object] = {
    # Pages that any user of this machine could read, and a way from them to other ports.
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    # A process that has died is seen; one that is at work for long in foreign code lives.
    "distributed.scheduler.worker-ttl": None,
}
"""Settings of Dask for processes of this run."""

# Dask takes its time to be imported, and is there where several workers are wanted.


@contextlib.contextmanager
def local_cluster(workers: int, interrupted: Callable[[], None]) -> Iterator["Client"]:
    """Start processes on this machine, which end with the block; yields the connection to them."""
    import dask
    from distributed import Client, LocalCluster, Security

    # Whoever reaches a scheduler runs code as its user: only who has this run's key does.
    security = Security.temporary()  # type: ignore[no-untyped-call]
    make_cluster: Callable[[], Any] = partial(
        LocalCluster,
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        # Any free port, of this machine only; it is closed as soon as Dask has opened it.
        scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
        worker_dashboard_address="127.0.0.1:0",
        memory_limit=0,
        security=security,
        silence_logs=CRITICAL,
    )
    others = {child.pid for child in multiprocessing.active_children()}
    with contextlib.ExitStack() as stack:
        stack.callback(_kill_all_but, others)
        try:
            with dask.config.set(OWN):
                cluster = waited_for(make_cluster, STARTING, interrupted)
            stack.callback(_end, cluster)
            cluster.scheduler.http_server.stop()
            cluster.scheduler.allowed_failures = DEATHS - 1
            client = stack.enter_context(Client(cluster, set_as_default=False))  # type: ignore[no-untyped-call]
            waited_for(partial(client.wait_for_workers, workers), STARTING, interrupted)
        except (OSError, TimeoutError, RuntimeError) as error:
            # A signal to all processes is heard by some of them first.
            interrupted()
            raise BackendError(f"the workers cannot be started: {error}") from error
        yield client


def _end(cluster: Any) -> None:
    """End a cluster of this run."""
    # Dask would do it once more at the exit.
    cluster.shutdown_on_close = False
    with contextlib.suppress(TimeoutError):
        cluster.close(timeout=LETTING_GO)


def _kill_all_but(others: Container[int | None]) -> None:
    """End processes of workers that have not ended by themselves: the exit waits for them."""
    for child in multiprocessing.active_children():
        if child.name.startswith("Dask Worker") and child.pid not in others:
            child.kill()


def stopped_workers(client: "Client") -> dict[int, str]:
    """Return this run's own workers that have been stopped, as by SIGSTOP: addresses by process."""
    if client.cluster is None:
        return {}
    own = {nanny.pid: str(nanny.worker_address) for nanny in client.cluster.workers.values()}
    return {pid: address for pid, address in own.items() if pid and _state(pid) == "T"}


def _state(pid: int) -> str:
    """Return the state of a process as the system has it; empty if it is not there."""
    try:
        # Its name, in parentheses, may have any character in it.
        return (PROC / str(pid) / "stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return ""


@dataclass(frozen=True)
class RunningCluster:
    """A Dask cluster that somebody has started.

    Attributes
    ----------
    address
        Of its scheduler.
    workers
        How many of its workers must be there.
    needs
        What all of them must have.
    timed
        Metrics that are measured times, so that a worker needs a core of its own.
    """

    address: str
    workers: int
    needs: Needs
    timed: tuple[str, ...] = ()

    @property
    def expected(self) -> Mapping[str, str]:
        """What this process has of what the workers must have."""
        return identity(self.needs.packages, self.needs.modules, self.needs.folder)

    @contextlib.contextmanager
    def connected(self, interrupted: Callable[[], None]) -> Iterator["Client"]:
        """Connect to it, and check what it has; yields the connection."""
        from distributed import Client
        from distributed.utils import silence_logging_cmgr

        self._check_keys()
        with contextlib.ExitStack() as stack:
            stack.enter_context(silence_logging_cmgr(CRITICAL))
            try:
                connect = partial(Client, self.address, timeout=CONNECTING, set_as_default=False)
                client = waited_for(connect, 2 * CONNECTING, interrupted)
            # Beside those of the network: of an address, of a certificate.
            except Exception as error:
                raise BackendError(f"no Dask scheduler at {self.address}: {error}") from error
            stack.enter_context(client)
            workers = self._wait_for_workers(client, interrupted)
            self._check(client, workers, interrupted)
            yield client

    def _check_keys(self) -> None:
        """Refuse TLS without keys, of which Dask would tell in some lines, and late."""
        from distributed import Security

        if not self.address.startswith("tls:"):
            return
        try:
            settings = Security().get_connection_args("client")  # type: ignore[no-untyped-call]
        except OSError as error:
            raise BackendError(f"the keys for {self.address} cannot be read: {error}") from error
        if settings.get("ssl_context") is None:
            raise BackendError(
                f"no keys for {self.address}; expected distributed.comm.tls.ca-file, client.cert "
                "and client.key in the configuration of Dask"
            )

    def _wait_for_workers(
        self, client: "Client", interrupted: Callable[[], None]
    ) -> Mapping[str, Any]:
        """Return what the scheduler knows of its workers, by address, once there are enough."""
        deadline = time.monotonic() + STARTING
        while len(workers := workers_of(client, interrupted)) < self.workers:
            if time.monotonic() > deadline:
                raise BackendError(
                    f"expected {self.workers} workers at {self.address}, found {len(workers)} "
                    f"after {STARTING:.0f} s"
                )
            time.sleep(LOOK_AROUND)
        return workers

    def _check(
        self, client: "Client", workers: Mapping[str, Any], interrupted: Callable[[], None]
    ) -> None:
        """Refuse a cluster of which a process cannot run the study as this one would."""
        for address, worker in workers.items():
            if worker["nthreads"] != 1:
                raise BackendError(
                    f"worker {address}: expected 1 thread, found {worker['nthreads']}; start it "
                    "with --nthreads 1, and several for several test runs"
                )
        needs = (self.needs.packages, self.needs.modules, self.needs.folder)
        of_all = partial(client.run, identity, *needs, on_error="return")
        # The scheduler reads what the run sends it, too.
        try:
            ask = partial(client.run_on_scheduler, identity, *needs)
            of_scheduler: object = waited_for(ask, check=interrupted)
        except Exception as error:
            of_scheduler = error
        self._compare(f"the scheduler {self.address}", of_scheduler)
        cores: dict[str, int] = {}
        try:
            of_workers = waited_for(of_all, check=interrupted)
        except TimeoutError as error:
            raise BackendError(f"a worker at {self.address} does not answer: {error}") from None
        for address, found in of_workers.items():
            known = self._compare(f"worker {address}", found)
            cores[str(workers[address]["host"])] = int(known[CORES])
        self._check_cores(Counter(str(worker["host"]) for worker in workers.values()), cores)

    def _compare(self, who: str, found: object) -> Mapping[str, str]:
        """Return what a process has, if that is what the run has."""
        if not isinstance(found, Mapping):
            raise BackendError(f"{who} does not have this version of bo_tuner: {found}")
        if text := differences(self.expected, found):
            raise BackendError(
                f"{who} does not have what the run has: {text}; install the same there, and "
                "start it anew"
            )
        return found

    def _check_cores(self, workers: Mapping[str, int], cores: Mapping[str, int]) -> None:
        for host, count in workers.items():
            if self.timed and (count := min(count, self.workers)) > cores.get(host, count):
                raise BackendError(
                    f"expected at most {cores[host]} workers on {host}, the number of its cores, "
                    f"found {count}: other workers make measured times longer "
                    f"({', '.join(self.timed)})"
                )


def workers_of(client: "Client", interrupted: Callable[[], None]) -> Mapping[str, Any]:
    """Return what the scheduler knows of its workers, by address; empty if it is gone.

    `interrupted` is asked while it is waited for.
    """
    if client.status != "running" or client.scheduler is None:
        return {}
    # What `scheduler_info` returns is replaced, beside, by an answer without the workers.
    ask = partial(client.sync, client.scheduler.identity, n_workers=-1)
    try:
        answer = waited_for(ask, check=interrupted)
    except OSError:
        return {}
    known: Mapping[str, Any] = answer["workers"]
    return known
