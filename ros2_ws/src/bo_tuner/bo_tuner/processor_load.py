"""The load of a computer during a run: how long processes waited for a processor.

There is one reading of it, in the `Outcome` of each run. What it is made of is in Linux only:
pressure stall information (PSI, Documentation/accounting/psi.rst), which a kernel may be without,
and the run delay of tasks (Documentation/scheduler/sched-stats.rst). What is not there is None.
"""

import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

PROC = Path("/proc")
MICROSECOND = 1e-6
HIGH = 0.2
"""Share of waiting from which on the load is high: times are then longer by a quarter."""


@dataclass(frozen=True)
class Load:
    """How busy the computer was during a run, as shares from 0 to 1.

    Attributes
    ----------
    machine
        Share of the run's time in which at least one process of the computer that the tuner runs
        on waited for a processor; None if the system does not say.
    nodes
        Of the time in which the run's own processes wanted a processor, the share in which they
        waited for one: what they do takes 1 / (1 - `nodes`) times as long. None if the system does
        not say, or they are not known, as those of attached nodes.

    Raises
    ------
    ValueError
        If one is no share.
    """

    machine: float | None
    nodes: float | None

    @property
    def share(self) -> float:
        """Share of waiting of the run's own processes, or else of the computer; 0 if not known."""
        return self.nodes if self.nodes is not None else self.machine or 0.0

    def __post_init__(self) -> None:
        for name, share in (("machine", self.machine), ("nodes", self.nodes)):
            if share is not None and not 0.0 <= share <= 1.0:
                raise ValueError(f"{name}: expected a share from 0 to 1, found {share}")


def explains(load: Load | None, gap: float, seconds: float) -> bool:
    """Whether a gap [s] in a run of so many seconds may be the computer's.

    It is not if all processes together have waited for a shorter time.
    """
    if load is None or load.share < HIGH:
        return False
    return load.machine is None or load.machine * seconds >= gap


def busy_share(load: Load | None) -> float | None:
    """Return the share of the time in which processes waited; None if the computer was not busy."""
    return None if load is None or load.share < HIGH else load.share


def busy_in_words(load: Load | None) -> str:
    """Return that the computer was busy, with how long was waited for it; empty if it was not."""
    share = busy_share(load)
    return "" if share is None else waited_in_words(share)


def waited_in_words(share: float) -> str:
    """Return that the computer was busy, by the share of the time that was waited for it."""
    return f"the computer was busy: processes waited for it {100.0 * share:.3g} % of the time"


class LoadMeter:
    """Measures the load from now on.

    Parameters
    ----------
    processes
        The run's own processes, by their identifiers.
    proc
        Where the system says it.
    """

    def __init__(self, processes: Iterable[int], proc: Path = PROC) -> None:
        self._proc = proc
        self._begin = time.monotonic()
        self._stalled = _stalled(proc)
        self._tasks = _tasks(proc, processes)

    def load(self, processes: Iterable[int]) -> Load:
        """Return the load since the beginning.

        Parameters
        ----------
        processes
            The run's own processes by now: some may have been started meanwhile.
        """
        elapsed = time.monotonic() - self._begin
        stalled = _stalled(self._proc)
        machine = None
        if stalled is not None and self._stalled is not None and elapsed > 0.0:
            machine = min(max((stalled - self._stalled) / elapsed, 0.0), 1.0)
        ran = waited = 0
        for task, (ran_by_now, waited_by_now) in _tasks(self._proc, processes).items():
            ran_before, waited_before = self._tasks.get(task, (0, 0))
            ran += max(ran_by_now - ran_before, 0)
            waited += max(waited_by_now - waited_before, 0)
        return Load(machine, waited / (ran + waited) if ran + waited else None)


def with_children(processes: Iterable[int], proc: Path = PROC) -> Iterator[int]:
    """Yield processes and all that they have started in turn."""
    due = list(processes)
    while due:
        process = due.pop()
        yield process
        for task in _tasks_of(proc, process):
            due += map(int, _text(task / "children").split())


def _stalled(proc: Path) -> float | None:
    """Return for how long [s] some process has waited for a processor since the system started."""
    some = next((line for line in _text(proc / "pressure/cpu").splitlines() if "some" in line), "")
    total = some.rpartition("total=")[2]
    return int(total) * MICROSECOND if total.isdecimal() else None


def _tasks(proc: Path, processes: Iterable[int]) -> Mapping[str, tuple[int, int]]:
    """Return for how long [ns] each task of processes has run, and waited to run."""
    times = {}
    for process in processes:
        for task in _tasks_of(proc, process):
            words = _text(task / "schedstat").split()
            if len(words) > 1:
                times[task.name] = int(words[0]), int(words[1])
    return times


def _tasks_of(proc: Path, process: int) -> list[Path]:
    try:
        return list((proc / str(process) / "task").iterdir())
    except OSError:
        # It has ended.
        return []


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii")
    except OSError:
        return ""
