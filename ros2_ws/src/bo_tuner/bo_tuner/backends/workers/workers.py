"""By how many workers a run is run, and where these are."""

from dataclasses import dataclass

from bo_tuner.text import counted


@dataclass(frozen=True)
class Bench:
    """A set of running nodes that is one of several alike.

    Attributes
    ----------
    name
        What the user calls it: its domain or its namespace.
    domain
        ROS domain of its nodes.
    namespace
        Their namespace.
    """

    name: str
    domain: int
    namespace: str

    @property
    def place(self) -> tuple[int, str]:
        """Where one tuner can be at work at a time."""
        return self.domain, self.namespace


@dataclass(frozen=True)
class Workers:
    """By how many workers a run is run, and where these are.

    Attributes
    ----------
    count
        How many evaluations are run at once.
    window
        Number of trials, or other tasks, that are planned at once.
    scheduler
        Address of the Dask cluster that has the workers; empty for processes of this machine.
    benches
        Running nodes for each of the workers, from the first on; empty if they start their own.
    """

    count: int = 1
    window: int = 1
    scheduler: str = ""
    benches: tuple[Bench, ...] = ()

    @property
    def pooled(self) -> bool:
        """Whether evaluations are run by processes of their own."""
        return self.count > 1 or bool(self.scheduler or self.benches)

    @property
    def text(self) -> str:
        """Tell of workers in a line; empty without any beside the run itself."""
        if not self.pooled:
            return ""
        where = f" of the cluster {self.scheduler}" if self.scheduler else ""
        planned = counted(self.window, "task") + " planned at once"
        return f"{counted(self.count, 'worker')}{where}, {planned}"
