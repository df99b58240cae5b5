"""What it costs to watch a run live: share of its time that goes into watching.

A whole run on nodes, with its bar on a terminal and a program that hears all the tuner's topics.
Counted is the wall time of all calls that hold up the run, and the processor time of the threads
beside it: together an upper bound, since with a core to spare the threads hold up nothing.
"""

import contextlib
import os
import pty
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path

from common import check_end, provenance, result_parser, table, write_result
from sections.cost import LIVE_PARTS

from bo_tuner.cli.session import RunOptions, Session
from bo_tuner.interruption import Interruption
from bo_tuner.methods.boundary.method import Boundary
from bo_tuner.methods.stopping import StopAdvisor
from bo_tuner.monitoring.node import HEADLINES, LiveNode
from bo_tuner.monitoring.progress import RunProgress
from bo_tuner.monitoring.status import RunStatus
from bo_tuner.storage.run_folder import RunFolder
from bo_tuner.study.study_file import load_study

LISTENER = f"""\
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import Float64

rclpy.init()
node = rclpy.create_node("listener")
heard = []
for topic in ("/diagnostics", "tuner/trial_result"):
    node.create_subscription(DiagnosticArray, topic, heard.append, 10)
for name in {HEADLINES!r}:
    node.create_subscription(Float64, f"tuner/{{name}}", heard.append, 10)
executor = SingleThreadedExecutor()
executor.add_node(node)
while True:
    executor.spin_once(timeout_sec=1.0)
"""


class Meter:
    """Adds up seconds by part; what is measured within another part counts there no more."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._inner: list[float] = []

    def timed(self, part: str, function: Callable) -> Callable:
        """Make a function count its wall time."""

        def call(*arguments: object, **options: object) -> object:
            self._inner.append(0.0)
            start = time.perf_counter()
            try:
                return function(*arguments, **options)
            finally:
                elapsed = time.perf_counter() - start
                self.seconds[part] += elapsed - self._inner.pop()
                if self._inner:
                    self._inner[-1] += elapsed

        return call

    def count_thread(self, part: str, thread: threading.Thread) -> None:
        """Count the processor time of a thread that is about to end."""
        if thread.ident is not None and thread.is_alive():
            clock = time.pthread_getcpuclockid(thread.ident)
            self.seconds[part] += time.clock_gettime(clock)


def install(meter: Meter) -> list[subprocess.Popen]:
    """Have the product's classes measured; returns a list that gets the listener when it starts."""
    listeners: list[subprocess.Popen] = []
    steps = {"begin", "recall", "evaluation", "advance", "trial"}
    for observer in (RunStatus, RunProgress, LiveNode):
        for name in steps.intersection(vars(observer)):
            setattr(observer, name, meter.timed("calls", getattr(observer, name)))
    StopAdvisor.consider = meter.timed("advice", StopAdvisor.consider)
    Boundary.incumbent = meter.timed("incumbent", Boundary.incumbent)
    enter, leave, draw_no_more = LiveNode.__init__, LiveNode.close, RunProgress.__exit__

    def start(self: LiveNode, *arguments: object) -> None:
        # Now the environment has the domain of the run.
        listeners.append(subprocess.Popen([sys.executable, "-c", LISTENER]))
        meter.timed("calls", enter)(self, *arguments)

    def stop(self: LiveNode) -> None:
        meter.count_thread("node_thread", self.thread)
        meter.timed("calls", leave)(self)

    def end_display(self: RunProgress, *error: object) -> None:
        for thread in threading.enumerate():
            if type(thread).__module__ == "rich.live":
                meter.count_thread("display_thread", thread)
        draw_no_more(self, *error)

    LiveNode.__init__ = start
    LiveNode.close = stop
    RunProgress.__exit__ = end_display
    return listeners


@contextlib.contextmanager
def on_terminal() -> Iterator[None]:
    """Let standard error be a terminal, whose content nobody sees."""
    leader, follower = pty.openpty()
    before = os.dup(2)
    os.dup2(follower, 2)

    def drain() -> None:
        with contextlib.suppress(OSError):
            while os.read(leader, 65536):
                pass

    reader = threading.Thread(target=drain, daemon=True)
    reader.start()
    try:
        yield
    finally:
        os.dup2(before, 2)
        os.close(follower)
        reader.join(5.0)
        os.close(leader)


def main() -> None:
    """Measure and report."""
    parser = result_parser(__doc__, "live_overhead.json")
    parser.add_argument("--study", default="benchmark", help="(default: %(default)s)")
    parser.add_argument("--trials", type=int, help="(default: the study's)")
    arguments = parser.parse_args()
    about = provenance()
    study = load_study(arguments.study).replace(trials=arguments.trials)
    meter = Meter()
    listeners = install(meter)
    with tempfile.TemporaryDirectory() as name:
        folder = RunFolder.create(Path(name), study)
        start = time.perf_counter()
        try:
            with on_terminal():
                code = Session(study, folder, RunOptions(), Interruption()).run()
        finally:
            for listener in listeners:
                listener.kill()
                listener.wait()
        elapsed = time.perf_counter() - start
    check_end(code)
    shares = {part: meter.seconds[part] / elapsed for part in LIVE_PARTS}
    result = {
        "provenance": about,
        "study": study.name,
        "seed": study.seed,
        "trials": study.budget.trials,
        "run_seconds": elapsed,
        "seconds": {part: meter.seconds[part] for part in LIVE_PARTS},
        "shares": shares,
        "share": sum(shares.values()),
    }
    write_result(arguments.result, result)
    rows = [
        (words, meter.seconds[part], f"{100 * shares[part]:.2f} %")
        for part, words in LIVE_PARTS.items()
    ]
    rows.append(("together", sum(meter.seconds.values()), f"{100 * result['share']:.2f} %"))
    print(table(("part", "s", "share of the run"), rows))
    print(f"a run of {elapsed:.0f} s, {study.budget.trials} trials")


if __name__ == "__main__":
    main()
