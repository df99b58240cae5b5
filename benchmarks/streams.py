"""How regular the messages of a stream are, as its subscriber in another process hears them.

A node with a watchdog hears a reference that streams in runs of the tuner, which records signals
at 100 Hz meanwhile and judges a condition. Rates in turn, on the machine as it is and with busy
processes beside, by the clock of the machine and by that of a simulation. The node takes down when
each message came; its watchdog would stop the machine after 0.1 s without one.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from common import opened, provenance, result_parser, table, write_result
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64

from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.backends.ros.clock import to_stamp
from bo_tuner.study.publishing import WATCHDOG
from bo_tuner.study.study_file import study_from_mapping
from bo_tuner.trials import Evaluation, Stage

BUSY = "while True: pass"
START, STOP = 60.0, 20.0
"""Time [s] for the node to come up, and to end."""


def machine(folder: Path, *, simulated: bool) -> None:
    """Be the node with the watchdog; writes its record when it is told to end."""
    over = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: over.set())
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    node = Node("machine")
    node.declare_parameter("gain", 1.0)
    heard: list[tuple[float, float]] = []

    def hear(message: Any) -> None:
        heard.append((time.monotonic(), message.data))

    node.create_subscription(Float64, "reference", hear, 1000)
    state = node.create_publisher(Float64, "state", 10)
    node.create_timer(0.01, lambda: state.publish(Float64(data=time.monotonic())))
    if simulated:
        clock = node.create_publisher(Clock, "/clock", 10)
        node.create_timer(0.002, lambda: clock.publish(Clock(clock=to_stamp(time.monotonic_ns()))))
    executor = rclpy.executors.SingleThreadedExecutor()
    executor.add_node(node)
    (folder / "up").touch()
    while not over.is_set():
        executor.spin_once(timeout_sec=0.1)
    (folder / "heard.json").write_text(json.dumps(heard))


def study(rate: float, seconds: float, *, simulated: bool) -> Any:
    """Return a study whose run is a stream."""
    stream = {
        "topic": "/reference",
        "rate": rate,
        "largest_gap": seconds,
        "profile": {"data": "t"},
    }
    return study_from_mapping(
        {
            "name": "streams",
            "nodes": {"machine": {"node": "machine"}},
            "parameters": {
                "gain": {"node": "machine", "type": "double", "bounds": [0.0, 2.0], "default": 1.0}
            },
            "signals": {"state": {"topic": "/state", "field": "data", "largest_gap": seconds}},
            "run": {
                "clock": "sim" if simulated else "wall",
                "start": [{"publish": stream}],
                "end": {"after": seconds},
                "timeout": seconds,
                "abort_when": "state < 0",
            },
            "metrics": {"mean": {"of": "state", "measure": "mean"}},
            "objective": {"metric": "mean"},
            "budget": {"trials": 1, "initial_trials": 1},
        }
    )


def measured(rate: float, seconds: float, *, busy: int, simulated: bool) -> dict[str, Any]:
    """Let a reference stream in a run; returns how its messages came."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        options = ["--machine", name, *(["--simulated"] if simulated else [])]
        node = subprocess.Popen([sys.executable, __file__, *options])
        beside = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(busy)]
        try:
            deadline = time.monotonic() + START
            while not (folder / "up").exists():
                if time.monotonic() > deadline:
                    raise SystemExit("error: the node does not come up")
                time.sleep(0.1)
            (folder / "log").mkdir()
            made = RosBackend(
                study(rate, seconds, simulated=simulated), folder / "log", attach=True
            )
            with opened(made) as backend:
                outcome = backend.outcome(Evaluation(0, 0, Stage.DRAWN, {"gain": 1.0}, {}, 1))
        finally:
            for process in beside:
                process.kill()
            node.terminate()
            node.wait(STOP)
        heard = np.array(json.loads((folder / "heard.json").read_text()))
    gaps = np.diff(heard[:, 0])
    deviations = np.abs(gaps - 1.0 / rate)
    return {
        "rate": rate,
        "clock": "simulated" if simulated else "machine",
        "busy": busy,
        "due": int(seconds * rate),
        "heard": len(heard),
        "state": str(outcome.state),
        "reason": outcome.reason,
        "said": str(outcome.notes.streams.get("/reference", "")),
        "deviation_median_ms": float(np.median(deviations)) * 1e3,
        "deviation_p99_ms": float(np.percentile(deviations, 99)) * 1e3,
        "gap_longest_ms": float(gaps.max()) * 1e3,
        "watchdog": int((gaps > WATCHDOG).sum()),
    }


def main() -> None:
    """Measure and report."""
    parser = result_parser(__doc__ or "", "streams.json")
    parser.add_argument("--seconds", type=float, default=20.0, help="(default: %(default)s)")
    parser.add_argument("--busy", type=int, default=4, help="processes (default: %(default)s)")
    parser.add_argument("--domain", type=int, default=76, help="(default: %(default)s)")
    parser.add_argument("--rates", type=float, nargs="+", default=[20.0, 50.0, 100.0, 500.0])
    parser.add_argument("--machine", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--simulated", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.machine is not None:
        machine(arguments.machine, simulated=arguments.simulated)
        return
    about = provenance()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ["ROS_DOMAIN_ID"] = str(arguments.domain)
    load = os.getloadavg()[0]
    rows = [
        measured(rate, arguments.seconds, busy=busy, simulated=simulated)
        for busy in (0, arguments.busy)
        for simulated in (False, True)
        for rate in arguments.rates
    ]
    result = {
        "provenance": about,
        "seconds": arguments.seconds,
        "load_before": load,
        "watchdog_s": WATCHDOG,
        "streams": rows,
    }
    write_result(arguments.result, result)
    keys = [key for key in rows[0] if key not in ("reason", "said")]
    print(table(keys, [[row[key] for key in keys] for row in rows]))


if __name__ == "__main__":
    main()
