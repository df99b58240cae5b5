"""`tune` beside other programs: whether the answer is feasible, and the solve time of the default.

The study `benchmark` limits computing time (``return_time: cpu``), over ROS and in process; beside
it one run in process, without and beside most of them, limits time by the clock. The other programs compute in bursts
by three threads each. Solve times are those of the default in its 25 test runs of the validation.
"""

import argparse
import contextlib
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import yaml
from common import A_RESULT, provenance, result_parser, start_command, table, write_result

from bo_tuner.lifetime import end_with_parent
from bo_tuner.storage.record import read_run
from bo_tuner.study.study_file import load_study, study_to_yaml
from bo_tuner.trials import DEFAULT, Stage

LOADS = (0, 4, 12)
"""Numbers of busy programs."""
BURST, PAUSE, THREADS = 0.3, 0.1, 3
"""Mean times [s] of a burst and of the pause after it, and its threads."""


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


def tuned(backend: str, source: str, load: int, seed: int, trials: int) -> dict[str, Any]:
    """Tune once beside other programs."""
    study = yaml.safe_load(study_to_yaml(load_study("benchmark")))
    for key in ("parameters", "inprocess_parameters"):
        study["nodes"]["controller"][key] = {"return_time": source}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "study.yaml").write_text(yaml.safe_dump(study, sort_keys=False))
        options = ("--backend", backend, "--trials", str(trials), "--seed", str(seed))
        begin = time.monotonic()
        with busy(load):
            process = start_command(folder, "tune", "--study", "study.yaml", "--quiet", *options)
            code = process.wait()
        if code not in A_RESULT:
            raise SystemExit(f"error: tune ended with {code}: {(folder / 'output').read_text()}")
        record = read_run(folder / "runs" / "latest")
        of_default = [
            e.outcome
            for e in record.evaluations
            if e.stage is Stage.VALIDATION and e.whose == DEFAULT and e.outcome.complete
        ]
        complete = [e for e in record.evaluations if e.outcome.complete]
        loads = [e.outcome.load for e in record.evaluations if e.outcome.load is not None]
        summary = record.summary or {}
        return {
            "backend": backend,
            "source": source,
            "programs": load,
            "seed": seed,
            "feasible": bool(summary["feasible"]),
            "too_slow": sum(e.outcome.metrics["return_time"] > LIMIT for e in complete),
            "of": len(complete),
            "seconds": time.monotonic() - begin,
            "p50": median(float(o.details["controller.return_time_p50"]) for o in of_default),
            "p99": median(o.metrics["return_time"] for o in of_default),
            "runs": len(of_default),
            "machine": _median([item.machine for item in loads]),
            "nodes": _median([item.nodes for item in loads]),
        }


def _median(shares: list[float | None]) -> float | None:
    known = [share for share in shares if share is not None]
    return median(known) if known else None


def main() -> None:
    """Measure and report."""
    parser = result_parser(__doc__, "busy_computer.json")
    parser.add_argument("--seeds", type=int, default=10, help="in process (default: %(default)s)")
    parser.add_argument("--trials", type=int, default=10, help="(default: %(default)s)")
    parser.add_argument(
        "--minutes", type=float, default=60.0, help="begin no run after (default: %(default)s)"
    )
    parser.add_argument("--burst", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.burst is not None:
        burst(arguments.burst)
    about = provenance() | {"seeds": list(range(1, arguments.seeds + 1))}
    plan = [
        ("inprocess", "cpu", LOADS[seed % len(LOADS)], seed)
        for seed in range(1, arguments.seeds + 1)
    ]
    # One without and beside most of the programs, by the clock, and the nodes over ROS.
    for backend, source in (("inprocess", "measured"), ("ros", "cpu")):
        plan += [(backend, source, load, 1) for load in (LOADS[0], LOADS[-1])]
    runs = []
    end = time.monotonic() + 60.0 * arguments.minutes
    for item in plan:
        if time.monotonic() > end:
            break
        runs.append(tuned(*item, arguments.trials))
        print(runs[-1], flush=True)
        write_result(
            arguments.result,
            {"provenance": about, "trials": arguments.trials, "runs": runs},
        )
    columns = ("backend", "source", "programs", "seed", "feasible", "p50", "p99", "too_slow", "of")
    print(table(columns, [[run[name] for name in columns] for run in runs]))


if __name__ == "__main__":
    main()
