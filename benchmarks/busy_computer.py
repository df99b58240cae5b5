"""Return times of the controller, and `tune` with limits on them, beside other programs.

Cuts of the default in process, by turns with times by the clock (``measured``) and with computing
time (``cpu``); with ``--seeds`` also whole runs of `tune` over ROS, which limits computing time.
The other programs compute in bursts, by three threads each.
"""

import argparse
import contextlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from common import A_RESULT, provenance, result_parser, start_command, write_result

from bo_tuner.lifetime import end_with_parent
from bo_tuner.processor_load import LoadMeter
from bo_tuner.storage.record import read_run
from milling_plant.cut import MillingPlant
from mpc_controller.controller import MpcController

LOADS = (0, 4, 12)
"""Numbers of busy programs."""
BURST, PAUSE, THREADS = 0.3, 0.1, 3
"""Mean times [s] of a burst and of the pause after it, and its threads."""


SOURCES, AT = ("measured", "cpu"), ("p50", "p99")
LIMIT = 0.002
"""Of the study on the solve time [s]."""


def burst(seed: int) -> None:
    """Compute in bursts, without end."""
    draw, matrix = random.Random(seed), np.random.default_rng(seed).standard_normal((400, 400))

    def work(end: float) -> None:
        while time.monotonic() < end:
            matrix @ matrix
            sum(range(20_000))

    while True:
        end = time.monotonic() + draw.expovariate(1.0 / BURST)
        threads = [threading.Thread(target=work, args=(end,)) for _ in range(THREADS)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        time.sleep(draw.expovariate(1.0 / PAUSE))


@contextlib.contextmanager
def busy(count: int) -> Iterator[None]:
    """Have so many programs compute."""
    programs = [
        subprocess.Popen(
            [sys.executable, __file__, "--burst", str(k)],
            preexec_fn=end_with_parent(signal.SIGKILL),
        )
        for k in range(count)
    ]
    try:
        # They import first.
        time.sleep(2.0 if programs else 0.0)
        yield
    finally:
        for program in programs:
            program.kill()
            program.wait()


def cuts(load: int, count: int) -> dict[str, Any]:
    """Cut with the default by turns with either time, each so often, beside other programs."""
    controller, plant = MpcController(), MillingPlant()
    times: dict[str, list[dict[str, float]]] = {source: [] for source in SOURCES}
    own = (os.getpid(),)
    with busy(load):
        meter = LoadMeter(own)
        for seed in range(count):
            plant.set_parameters({"seed": seed})
            for source in SOURCES:
                controller.set_parameters({"return_time": source})
                plant.evaluate(controller)
                result = controller.result()
                times[source].append({name: float(result[f"return_time_{name}"]) for name in AT})
        found = meter.load(own)
    return {
        "programs": load,
        "load": asdict(found),
        "cuts": count,
        **{
            source: {
                **{name: median(cut[name] for cut in of_source) for name in AT},
                "too_slow": sum(cut["p99"] > LIMIT for cut in of_source),
            }
            for source, of_source in times.items()
        },
    }


def tuned(load: int, seed: int) -> dict[str, Any]:
    """Run `tune` over ROS beside other programs."""
    with tempfile.TemporaryDirectory() as name, busy(load):
        folder = Path(name)
        process = start_command(folder, "tune", "--quiet", "--seed", str(seed))
        code = process.wait()
        if code not in A_RESULT:
            raise SystemExit(f"error: tune ended with {code}: {(folder / 'output').read_text()}")
        record = read_run(folder / "runs" / "latest")
    complete = [e.outcome for e in record.evaluations if e.outcome.complete]
    return {
        "programs": load,
        "seed": seed,
        "feasible": code == A_RESULT[0],
        "runs": len(complete),
        "too_slow": sum(outcome.metrics["return_time"] > LIMIT for outcome in complete),
    }


def main() -> None:
    """Measure and report."""
    parser = result_parser(__doc__, "busy_computer.json")
    parser.add_argument("--cuts", type=int, default=25, help="(default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=0, help="runs of tune (default: none)")
    parser.add_argument("--burst", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.burst is not None:
        burst(arguments.burst)
    about = provenance()
    result: dict[str, Any] = {"provenance": about, "cuts": [], "tuned": []}
    for load in LOADS:
        result["cuts"].append(cuts(load, arguments.cuts))
        print(result["cuts"][-1], flush=True)
    for seed in range(1, arguments.seeds + 1):
        result["tuned"].append(tuned(LOADS[seed % len(LOADS)], seed))
        print(result["tuned"][-1], flush=True)
    write_result(arguments.result, result)


if __name__ == "__main__":
    main()
