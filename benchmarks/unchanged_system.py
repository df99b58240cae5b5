"""What it takes to tune a system that knows nothing of the tuner.

The nodes are those of examples/unchanged_system, attached to as they run, and a node that counts on
two topics, 100 and 1000 times a second. Measured are the lines of the study and of an adapter, the
time from the start of the command to the first finished trial, the time of a run beyond the
procedure's own, messages that were lost, and the time of each measure on a long signal.
"""

import contextlib
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from common import (
    BENCHMARKS,
    check_end,
    events,
    opened,
    provenance,
    result_parser,
    start_tuning,
    table,
    write_result,
)

from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.metrics.recording import RecordedSignal, Recording
from bo_tuner.numerics.expressions import Expression
from bo_tuner.numerics.signal_metrics import MEASURES, options_of
from bo_tuner.study.study_file import load_study, study_from_mapping, study_to_mapping
from bo_tuner.trials import Evaluation, EvaluationState, Stage

EXAMPLE = BENCHMARKS.parent / "examples" / "unchanged_system"
NODES = ("motor_node.py", "pid_node.py")
STUDY = EXAMPLE / "study.yaml"
RATES = {"slow": 100, "fast": 1000}
"""Messages a second, by topic."""
PROCEDURE = 0.5
"""Time [s] of a measured run: the wait before it, and the run itself."""
WAIT = 0.1
SAMPLES = 200_000
REPEATS = 7
COUNTER = f"""\
import rclpy
from rclpy.executors import ExternalShutdownException
from std_msgs.msg import Float64

rclpy.init()
node = rclpy.create_node("counter")
for topic, rate in {RATES!r}.items():
    def tick(publisher=node.create_publisher(Float64, topic, 10), message=Float64()):
        message.data += 1.0
        publisher.publish(message)
    node.create_timer(1.0 / rate, tick)
try:
    rclpy.spin(node)
except ExternalShutdownException:
    pass
"""


@contextlib.contextmanager
def running(*programs: Sequence[str]) -> Iterator[None]:
    """Run programs of Python, each a list of arguments, in a ``with`` block."""
    processes = [subprocess.Popen([sys.executable, *arguments]) for arguments in programs]
    try:
        yield
    finally:
        for process in processes:
            process.terminate()
        for process in processes:
            process.wait()


def adapter_lines() -> int:
    """Count the lines of the example's nodes that are there for the tuner."""
    words = ("bo_tuner", "Trigger", "DiagnosticArray")
    lines = [line for name in NODES for line in (EXAMPLE / name).read_text().splitlines()]
    return sum(any(word in line for word in words) for line in lines)


def first_trial(folder: Path) -> float:
    """Return the time [s] from the start of the command to its first finished trial."""
    start = time.perf_counter()
    process = start_tuning(
        *("--study", str(STUDY), "--attach", "--trials", "1", "--output", str(folder))
    )
    elapsed = float("nan")
    for event in events(process):
        if event["event"] == "trial" and math.isnan(elapsed):
            elapsed = time.perf_counter() - start
    check_end(process.wait())
    return elapsed


def measured_study() -> Mapping[str, Any]:
    """Return the example's study with short runs, which also hear the counter."""
    mapping = dict(study_to_mapping(load_study(str(STUDY))))
    signals = {name: {"topic": f"/{name}", "field": "data"} for name in RATES}
    begin = [
        {"publish": {"topic": "/setpoint", "message": {"data": 0.0}}},
        {"call": {"service": "/motor/reset"}},
        {"wait": WAIT},
    ]
    start = [{"publish": {"topic": "/setpoint", "message": {"data": 1.0}}}]
    mapping["signals"] = {**mapping["signals"], **signals}  # type: ignore[dict-item]
    mapping["run"] = {"before": begin, "start": start, "end": {"after": PROCEDURE - WAIT}}
    return mapping


def measure_runs(count: int, folder: Path) -> dict[str, Any]:
    """Run the measured study; returns the overheads [s] and the counts of messages."""
    study = study_from_mapping(measured_study())
    defaults = study.search_space().defaults
    overheads, seen, missing = [], dict.fromkeys(RATES, 0), dict.fromkeys(RATES, 0)
    with opened(RosBackend(study, folder, attach=True)) as backend:
        for index in range(count):
            # Another value each time, which is set and read back as in a study.
            parameters = {**defaults, "kp": 0.5 + 0.001 * index}
            planned = Evaluation(0, index, Stage.NOMINAL, parameters, {}, index)
            start = time.perf_counter()
            (evaluation,) = backend.run([planned])
            overheads.append(time.perf_counter() - start - PROCEDURE)
            if evaluation.outcome.state is not EvaluationState.COMPLETE:
                raise SystemExit(f"error: run {index}: {evaluation.outcome.reason}")
            for name in RATES:
                signal = backend.recording.signals[name]
                value = signal.value[signal.time >= 0.0]
                seen[name] += len(value)
                missing[name] += int(value[-1] - value[0]) + 1 - len(value)
    return {
        "runs": count,
        "procedure_seconds": PROCEDURE,
        "overhead_median": median(overheads),
        "overhead_p90": float(np.quantile(overheads, 0.9)),
        "messages": seen,
        "missing": missing,
    }


def measure_metrics() -> dict[str, float]:
    """Return the median processor time [s] of each measure, of one signal and of two together."""
    rng = np.random.default_rng(1)
    signals = {
        name: RecordedSignal(
            np.cumsum(rng.uniform(0.5e-3, 1.5e-3, SAMPLES)), rng.normal(size=SAMPLES).cumsum()
        )
        for name in ("a", "b")
    }
    recording = Recording(signals, max(float(s.time[-1]) for s in signals.values()))
    found = {}
    for label, text, names in (
        ("one signal", "a", ("a",)),
        ("two signals", "abs(a - b)", ("a", "b")),
    ):
        expression = Expression(text, names)
        for measure, function in MEASURES.items():
            # The end is the target, so that every measure is defined.
            target = float(recording.sample(expression)[1][-1])
            options = {"target": target, "percent": 95.0, "band": 10.0}
            given = {key: options[key] for key in options_of(measure)}

            def compute(
                function: Callable[..., float] = function,
                given: Mapping[str, float] = given,
                expression: Expression = expression,
            ) -> None:
                function(*recording.sample(expression), **given)

            found[f"{measure} of {label}"] = median(_processor_seconds(compute))
    return found


def _processor_seconds(function: Callable[[], None]) -> list[float]:
    seconds = []
    for _ in range(REPEATS):
        start = time.thread_time()
        function()
        seconds.append(time.thread_time() - start)
    return seconds


def main() -> None:
    """Measure and report."""
    parser = result_parser(__doc__, "unchanged_system.json")
    parser.add_argument("--runs", type=int, default=100, help="(default: %(default)s)")
    parser.add_argument("--domain", type=int, default=87, help="(default: %(default)s)")
    arguments = parser.parse_args()
    about = provenance()
    os.environ["ROS_DOMAIN_ID"] = str(arguments.domain)
    metrics = measure_metrics()
    nodes = [[str(EXAMPLE / name)] for name in NODES]
    with tempfile.TemporaryDirectory() as name:
        with running(*nodes):
            until_trial = first_trial(Path(name))
        with running(*nodes, ["-c", COUNTER]):
            runs = measure_runs(arguments.runs, Path(name))
    slowest = max(metrics, key=metrics.__getitem__)
    result = {
        "provenance": about,
        "study_lines": len(STUDY.read_text(encoding="utf-8").splitlines()),
        "adapter_lines": adapter_lines(),
        "first_trial_seconds": until_trial,
        "runs": runs,
        "samples": SAMPLES,
        "metric_seconds": metrics,
        "slowest_metric": slowest,
        "load_average": os.getloadavg()[0],
    }
    write_result(arguments.result, result)
    rows = [
        ("lines of the study", result["study_lines"]),
        ("lines of an adapter", result["adapter_lines"]),
        ("first finished trial [s]", until_trial),
        ("overhead of a run, median [ms]", 1e3 * float(str(runs["overhead_median"]))),
        *((f"messages missing at {RATES[k]} Hz", n) for k, n in dict(runs["missing"]).items()),  # type: ignore[call-overload]
        (f"slowest metric, {slowest} [ms]", 1e3 * metrics[slowest]),
    ]
    print(table(("figure", "value"), rows))


if __name__ == "__main__":
    main()
