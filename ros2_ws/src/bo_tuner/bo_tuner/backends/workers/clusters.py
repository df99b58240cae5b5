"""Connections to Dask: processes of this machine that are started, or a cluster that runs."""

import contextlib
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bo_tuner.backends.workers.identity import CORES, Needs, differences, identity
from bo_tuner.errors import BackendError

if TYPE_CHECKING:
    from distributed import Client

STARTING = 60.0
"""Time [s] that the processes of the workers have to come up."""
CONNECTING = 10.0
"""Time [s] that a scheduler has to answer."""
DEATHS = 3
"""Worker processes on this machine that may end while they run the same evaluation; then it is
lost."""
LOOK_AROUND = 0.1
"""Time [s] after which a wait gives way to a signal."""
CRITICAL = 50
"""Level of what Dask may log: what matters is told by the run."""

# Dask takes its time to be imported, and is there where several workers are wanted.


@contextlib.contextmanager
def local_cluster(workers: int) -> Iterator["Client"]:
    """Start processes on this machine, which end with the block; yields the connection to them.

    Raises
    ------
    ImportError
        If Dask, or what it takes for TLS, is not installed.
    BackendError
        If one does not come up.
    """
    from distributed import Client, LocalCluster, Security

    # Whoever reaches a scheduler runs code as its user: only who has this run's key does.
    security = Security.temporary()  # type: ignore[no-untyped-call]
    with contextlib.ExitStack() as stack:
        try:
            cluster = stack.enter_context(
                LocalCluster(  # type: ignore[no-untyped-call]
                    n_workers=workers,
                    threads_per_worker=1,
                    processes=True,
                    host="127.0.0.1",
                    # Status pages have ports, too: any free one, of this machine only.
                    scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
                    worker_dashboard_address="127.0.0.1:0",
                    memory_limit=0,
                    security=security,
                    silence_logs=CRITICAL,
                )
            )
            cluster.scheduler.allowed_failures = DEATHS - 1
            client = stack.enter_context(Client(cluster, set_as_default=False))  # type: ignore[no-untyped-call]
            client.wait_for_workers(workers, timeout=STARTING)
        except (OSError, TimeoutError, RuntimeError) as error:
            raise BackendError(f"the workers cannot be started: {error}") from error
        yield client


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
        """Connect to it, and check what it has; yields the connection.

        Parameters
        ----------
        interrupted
            Asked while waiting; raises what shall end the wait.

        Raises
        ------
        ImportError
            If Dask is not installed.
        BackendError
            If it does not answer, has too few workers, or one of them has another installation or
            too few cores.
        """
        from distributed import Client
        from distributed.utils import silence_logging_cmgr

        self._check_keys()
        with contextlib.ExitStack() as stack:
            stack.enter_context(silence_logging_cmgr(CRITICAL))
            try:
                client = Client(self.address, timeout=CONNECTING, set_as_default=False)  # type: ignore[no-untyped-call]
            # Beside those of the network: of an address, of a certificate.
            except Exception as error:
                raise BackendError(f"no Dask scheduler at {self.address}: {error}") from error
            stack.enter_context(client)
            workers = self._wait_for_workers(client, interrupted)
            self._check(client, workers)
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
        while len(workers := workers_of(client)) < self.workers:
            interrupted()
            if time.monotonic() > deadline:
                raise BackendError(
                    f"expected {self.workers} workers at {self.address}, found {len(workers)} "
                    f"after {STARTING:.0f} s"
                )
            time.sleep(LOOK_AROUND)
        return workers

    def _check(self, client: "Client", workers: Mapping[str, Any]) -> None:
        """Refuse a cluster of which a process cannot run the study as this one would."""
        for address, worker in workers.items():
            if worker["nthreads"] != 1:
                raise BackendError(
                    f"worker {address}: expected 1 thread, found {worker['nthreads']}; start it "
                    "with --nthreads 1, and several for several test runs"
                )
        needs = (self.needs.packages, self.needs.modules, self.needs.folder)
        # The scheduler reads what the run sends it, too.
        try:
            of_scheduler: object = client.run_on_scheduler(identity, *needs)  # type: ignore[no-untyped-call]
        except Exception as error:
            of_scheduler = error
        self._compare(f"the scheduler {self.address}", of_scheduler)
        cores: dict[str, int] = {}
        for address, found in client.run(identity, *needs, on_error="return").items():
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


def workers_of(client: "Client") -> Mapping[str, Any]:
    """Return what the scheduler knows of its workers, by address; empty if it is gone."""
    if client.status != "running" or client.scheduler is None:
        return {}
    try:
        # What `scheduler_info` returns is replaced, beside, by an answer without the workers.
        answer = client.sync(client.scheduler.identity, n_workers=-1)  # type: ignore[no-untyped-call]
    except OSError:
        return {}
    known: Mapping[str, Any] = answer["workers"]
    return known
