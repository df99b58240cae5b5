"""What recording costs: time of a cut with and without it, in turns on the same nodes.

A round is a trial without a recording and one with it, in changing order; both have the same
parameters, contexts and seeds. Counted is all that a trial takes over ROS, the wait for its last
messages and the hand-over to the writer included.
"""

import statistics
import tempfile
import time
from functools import partial
from pathlib import Path

from common import opened, provenance, result_parser, table, write_result

from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.recording.retention import Policy, RecordOptions
from bo_tuner.recording.run_recording import RunRecording
from bo_tuner.recording.topic_listener import TopicListener
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import load_study
from bo_tuner.trials import Evaluation, EvaluationState, Stage, Trial, TrialState


def run_trial(
    study: Study, backend: RosBackend, number: int, evaluations: int, folder: Path | None
):
    """Run a trial; returns its wall time per cut [s], and what the recording says of itself."""
    parameters = study.search_space().defaults
    contexts = study.context_space()
    nominal = contexts.to_dict(contexts.nominal())
    options = RecordOptions(Policy.ALL if folder else Policy.NONE)
    listen = partial(TopicListener, backend.context, backend.nodes, backend.topics)
    with RunRecording(folder or Path(), study, options, listen, print) as recording:
        record: list[Evaluation] = []
        start = time.perf_counter()
        for index in range(evaluations):
            seed = 1 + index
            planned = Evaluation(number, index, Stage.DRAWN, parameters, nominal, seed)
            record += backend.run([planned])
            outcome = record[-1].outcome
            if outcome.state is not EvaluationState.COMPLETE:
                raise SystemExit(f"error: {outcome.reason}")
            recording.evaluation(record[-1])
        trial = Trial(
            number, parameters, "benchmark", TrialState.COMPLETE, evaluations=tuple(record)
        )
        recording.trial(trial, None)
        elapsed = time.perf_counter() - start
    return elapsed / evaluations, recording.summary


def main() -> None:
    """Measure and report."""
    parser = result_parser(__doc__, "recording.json")
    parser.add_argument("--rounds", type=int, default=20, help="(default: %(default)s)")
    parser.add_argument(
        "--evaluations", type=int, default=12, help="of a trial (default: %(default)s)"
    )
    arguments = parser.parse_args()
    about = provenance()
    study = load_study("benchmark")
    plain: list[float] = []
    recorded: list[float] = []
    missing = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "log").mkdir()
        with opened(RosBackend(study, folder / "log")) as backend:
            run_trial(study, backend, 0, arguments.evaluations, None)
            for k in range(arguments.rounds):
                for with_bag in (False, True) if k % 2 else (True, False):
                    run = folder if with_bag else None
                    time_per_evaluation, said = run_trial(
                        study, backend, k, arguments.evaluations, run
                    )
                    (recorded if with_bag else plain).append(time_per_evaluation)
                    if with_bag:
                        missing += said["dropped_messages"] + said["lost_messages"]
    ratios = [a / b for a, b in zip(recorded, plain, strict=True)]
    quartiles = statistics.quantiles(ratios, n=4)
    result = {
        "provenance": about,
        "cuts_per_trial": arguments.evaluations,
        "seconds_per_cut_plain": plain,
        "seconds_per_cut_recorded": recorded,
        "ratio_median": statistics.median(ratios),
        "ratio_quartiles": [quartiles[0], quartiles[2]],
        "ratio_of_sums": sum(recorded) / sum(plain),
        "missing_messages": missing,
    }
    write_result(arguments.result, result)
    rows = [
        ("without", statistics.median(plain), min(plain), max(plain)),
        ("with", statistics.median(recorded), min(recorded), max(recorded)),
    ]
    print(table(("recording", "median s/cut", "min", "max"), rows))
    print(
        f"ratio: median {result['ratio_median']:.3f}, quartiles {quartiles[0]:.3f} to "
        f"{quartiles[2]:.3f}, of the sums {result['ratio_of_sums']:.3f}; "
        f"{missing} messages missing"
    )


if __name__ == "__main__":
    main()
