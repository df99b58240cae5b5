"""10,000 cuts over ROS: memory, file handles, threads and shared memory of tuner and nodes.

The cuts run as in a tuning run, by the same backend on nodes of its own, in trials of 12 with other
parameters, contexts and seeds each time, recorded in a journal and, notable trials, in bags; only
the proposals are drawn at random. All processes are looked at in /proc after every 100 cuts. Growth
is the slope of a straight line through what was seen after the first tenth.
"""

import os
import re
import resource
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from common import opened, provenance, result_parser, table, write_result

from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.recording.recorder import Recorder
from bo_tuner.recording.retention import RecordOptions
from bo_tuner.recording.run_recording import RunRecording
from bo_tuner.recording.topic_listener import TopicListener
from bo_tuner.storage.journal import Journal
from bo_tuner.study.study_file import load_study
from bo_tuner.trials import Evaluation, EvaluationState, Stage, Trial, TrialState

SEED = 1
CUTS_PER_TRIAL = 12
LOOK_EVERY = 100
WARM_UP = 0.1
QUANTITIES = ("memory_kb", "file_handles", "threads", "shared_memory_files")


def look(pid: int) -> dict[str, int]:
    """Resources of a process: resident memory [kB] and counts."""
    folder = Path("/proc") / str(pid)
    status = (folder / "status").read_text()
    shared = set(re.findall(r"/dev/shm/\S*fast\S*", (folder / "maps").read_text()))
    return {
        "memory_kb": int(re.search(r"^VmRSS:\s+(\d+)", status, re.M)[1]),
        "file_handles": len(list((folder / "fd").iterdir())),
        "threads": int(re.search(r"^Threads:\s+(\d+)", status, re.M)[1]),
        "shared_memory_files": len(shared),
    }


def growth(evaluations: list[int], values: list[int]) -> dict[str, float]:
    """First and last value after the warm-up, the largest, and the slope per 1000 cuts."""
    start = int(WARM_UP * len(values))
    slope = (
        np.polyfit(evaluations[start:], values[start:], 1)[0] if len(values) - start > 1 else 0.0
    )
    return {
        "first": values[start],
        "last": values[-1],
        "largest": max(values[start:]),
        "per_1000_cuts": float(1000.0 * slope),
    }


def run(evaluations: int, folder: Path) -> dict[str, Any]:
    """Run cuts and look at the processes meanwhile."""
    study = load_study("benchmark")
    space, contexts = study.search_space(), study.context_space()
    trials = -(-evaluations // CUTS_PER_TRIAL)
    rng = np.random.default_rng(SEED)
    design = space.latin_hypercube(trials, rng)
    (folder / "log").mkdir()
    backend = RosBackend(study, folder / "log")
    seen: dict[str, dict[str, list[int]]] = {}
    counts: list[int] = []
    states: Counter[str] = Counter()
    reasons: Counter[str] = Counter()
    done = ignored = 0
    begin = time.perf_counter()

    def listen(recorder: Recorder) -> TopicListener:
        return TopicListener(backend.context, backend.nodes, backend.topics, recorder)

    def look_around() -> None:
        counts.append(done)
        pids = {key: process.pid for key, process in backend._started.processes.items()}
        for name, pid in ({"tuner": os.getpid()} | pids).items():
            for quantity, value in look(pid).items():
                seen.setdefault(name, {}).setdefault(quantity, []).append(value)

    with opened(backend):
        pids = [process.pid for process in backend._started.processes.values()]
        recording = RunRecording(folder, study, RecordOptions(), listen, print)
        with Journal(folder / "journal.sqlite", {"study": study.name}) as journal, recording:
            for number in range(trials):
                parameters = space.to_parameters(design[number])
                record: list[Evaluation] = []
                for index in range(min(CUTS_PER_TRIAL, evaluations - done)):
                    context = contexts.to_dict(contexts.draw(1, rng)[0])
                    seed = int(rng.integers(2**31))
                    planned = Evaluation(number, index, Stage.DRAWN, parameters, context, seed)
                    (evaluation,) = backend.run([planned])
                    outcome = evaluation.outcome
                    journal.record_evaluation(evaluation)
                    recording.evaluation(evaluation)
                    record.append(evaluation)
                    states[str(outcome.state)] += 1
                    if outcome.state is not EvaluationState.COMPLETE:
                        reasons[outcome.reason] += 1
                    ignored += outcome.notes.ignored_results
                    done += 1
                    if done % LOOK_EVERY == 0:
                        look_around()
                whole = all(
                    evaluation.outcome.state is EvaluationState.COMPLETE for evaluation in record
                )
                state = TrialState.COMPLETE if whole else TrialState.FAILED
                trial = Trial(number, parameters, "soak", state, evaluations=tuple(record))
                journal.record_trial(trial)
                recording.trial(trial, None)
        same = pids == [process.pid for process in backend._started.processes.values()]
    return {
        "seed": SEED,
        "cuts": done,
        "seconds": time.perf_counter() - begin,
        "states": dict(states),
        "reasons": dict(reasons),
        "ignored_results": ignored,
        "same_node_processes_throughout": same,
        "growth": {
            name: {q: growth(counts, values[q]) for q in QUANTITIES}
            for name, values in seen.items()
        },
        "looked_at_after_cuts": counts,
        "seen": seen,
        "recording": recording.summary,
        "largest_memory_of_tuner_kb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
    }


def main() -> None:
    """Run and report."""
    parser = result_parser(__doc__, "soak.json")
    parser.add_argument("--evaluations", type=int, default=10_000, help="(default: %(default)s)")
    arguments = parser.parse_args()
    origin = provenance()
    with tempfile.TemporaryDirectory() as name:
        result = run(arguments.evaluations, Path(name))
    write_result(arguments.result, {"provenance": origin} | result)
    rows = [
        [name, quantity, *figures.values()]
        for name, of_process in result["growth"].items()
        for quantity, figures in of_process.items()
    ]
    print(table(["process", "quantity", "first", "last", "largest", "per 1000 cuts"], rows))
    print(f"{result['cuts']} cuts in {result['seconds']:.0f} s: {result['states']}")


if __name__ == "__main__":
    main()
