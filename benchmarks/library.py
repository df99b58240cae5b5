"""What the interface from Python costs: lines of a program, time of its import, overhead of a run.

lines
    Of `PROGRAM`, the smallest that tunes a function within a limit over contexts, and certifies the
    result; without blank lines. It is run.
import
    Processes that import `bo_tuner`, which loads nothing until it is used, and those that use all
    of its names, beyond those that import NumPy, in turn.
overhead
    Of a run whose function takes 1 ms: the time of `Study.optimize` for each call, beyond that of
    the function. Beside it as many trials by ask and tell of Optuna, with its default sampler, TPE,
    and without a limit or contexts. The tasks differ: ours models each metric over parameters and
    contexts, and writes each result to disk.

One thread; times are those of the processor, which other load disturbs less than the clock's.
"""

import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

# Before the libraries that read them.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import optuna
from common import provenance, result_parser, table, write_result

import bo_tuner as bt

PROGRAM = """\
import bo_tuner as bt

def run(parameters, context, seed):
    gain, load = parameters["gain"], context["load"]
    return {"error": 1.0 + load * (gain - 0.3) ** 2, "peak": 2.0 * gain * load}

study = bt.Study(
    name="axis",
    parameters={"gain": bt.Double(0.0, 1.0, default=0.5)},
    contexts={"load": bt.Uniform(bounds=(1.0, 2.0))},
    metrics=["error", "peak"],
    objective="error",
    constraints={"peak": bt.WorstCase("peak", upper=1.0)},
    budget=bt.Budget(trials=8, initial_trials=5),
)
result = study.optimize(run)
print(result.best, result.certify(run, runs=200).verdict)
"""
IMPORTS = {"bo_tuner": "import bo_tuner", "names": "import of all its names"}
NAMES = "import numpy\nimport bo_tuner as bt\nfor name in bt.__all__:\n    getattr(bt, name)\n"
CALL = 0.001
"""Time of the function [s]."""


def timed(program: str) -> float:
    """Return the processor's time of a process that runs a program [s]."""
    begin = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", program], check=True)
    end = resource.getrusage(resource.RUSAGE_CHILDREN)
    return end.ru_utime + end.ru_stime - begin.ru_utime - begin.ru_stime


def of_imports(count: int) -> dict[str, list[float]]:
    """Return the times of imports beyond NumPy's [s], without a first turn that fills caches."""
    programs = {"numpy": "import numpy", "bo_tuner": "import numpy, bo_tuner", "names": NAMES}
    times = [{name: timed(code) for name, code in programs.items()} for _ in range(count + 1)]
    return {name: [turn[name] - turn["numpy"] for turn in times[1:]] for name in IMPORTS}


class Function:
    """Takes `CALL`, and counts its calls.

    Attributes
    ----------
    calls
        How many there were.
    seconds
        What they took together.
    """

    def __init__(self) -> None:
        self.calls, self.seconds = 0, 0.0

    def __call__(
        self, parameters: dict[str, Any], context: dict[str, Any], seed: int
    ) -> dict[str, float]:
        """Return error and peak of the program above, by two parameters."""
        begin = time.process_time()
        while time.process_time() - begin < CALL:
            pass
        gain, bias, load = parameters["gain"], parameters["bias"], context["load"]
        self.calls += 1
        self.seconds += time.process_time() - begin
        return {"error": 1.0 + load * (gain - 0.3) ** 2 + bias**2, "peak": 2.0 * gain * load}


def by_optimize(trials: int) -> tuple[int, float]:
    """Return the calls of a run, and its time for each beyond the function's [s]."""
    study = bt.Study(
        name="axis",
        parameters={
            "gain": bt.Double(0.0, 1.0, default=0.5),
            "bias": bt.Double(-1.0, 1.0, default=0.5),
        },
        contexts={"load": bt.Uniform(bounds=(1.0, 2.0))},
        metrics=["error", "peak"],
        objective="error",
        constraints={"peak": bt.WorstCase("peak", upper=1.0)},
        budget=bt.Budget(trials=trials, initial_trials=8),
    )
    function = Function()
    with tempfile.TemporaryDirectory() as folder:
        begin = time.process_time()
        study.optimize(function, Path(folder) / "run", progress=False)
        took = time.process_time() - begin
    return function.calls, (took - function.seconds) / function.calls


def by_optuna(calls: int, seed: int) -> float:
    """Return the time of a trial by ask and tell beyond the function's [s]."""
    function = Function()
    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=seed))
    begin = time.process_time()
    for _ in range(calls):
        trial = study.ask()
        gain, bias = trial.suggest_float("gain", 0.0, 1.0), trial.suggest_float("bias", -1.0, 1.0)
        study.tell(trial, function({"gain": gain, "bias": bias}, {"load": 1.5}, 0)["error"])
    return (time.process_time() - begin - function.seconds) / calls


def main() -> None:
    """Measure and report."""
    parser = result_parser(__doc__, "library.json")
    parser.add_argument("--turns", type=int, default=5, help="(default: %(default)s)")
    parser.add_argument("--trials", type=int, default=20, help="of a run (default: %(default)s)")
    arguments = parser.parse_args()
    about = provenance()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    lines = len([line for line in PROGRAM.splitlines() if line.strip()])
    subprocess.run([sys.executable, "-c", PROGRAM], check=True, stderr=subprocess.DEVNULL)
    overhead: dict[str, list[float]] = {"optimize": [], "Optuna": []}
    for turn in range(arguments.turns):
        calls, seconds = by_optimize(arguments.trials)
        overhead["optimize"].append(seconds)
        overhead["Optuna"].append(by_optuna(calls, turn))
    imports = of_imports(arguments.turns)
    result = {
        "provenance": about,
        "lines": lines,
        "import": imports,
        "calls": calls,
        "overhead": overhead,
    }
    write_result(arguments.result, result)
    rows = [(f"{IMPORTS[name]}, beyond NumPy [s]", values) for name, values in imports.items()]
    rows += [(f"{name}, each call [s]", values) for name, values in overhead.items()]
    shown = [
        (what, *(f"{value:.4f}" for value in (statistics.median(v), min(v), max(v))))
        for what, v in rows
    ]
    print(f"{lines} lines; {calls} calls in a run")
    print(table(("", "median", "least", "largest"), shown))


if __name__ == "__main__":
    main()
