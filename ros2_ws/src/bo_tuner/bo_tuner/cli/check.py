"""``check``: hold a study against its nodes, try two runs, and what each parameter does."""

import argparse
import contextlib
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.backends.ros.graph import opened_node
from bo_tuner.backends.ros.isolation import named_namespace
from bo_tuner.backends.ros.tuner_node import TunerNode
from bo_tuner.cli.answers import find_answers
from bo_tuner.cli.check_times import time_of
from bo_tuner.cli.common import Parser, ended, guarded, opened, split_ros_arguments
from bo_tuner.cli.exit_codes import EXIT_INFEASIBLE, EXIT_OK, EXIT_USAGE
from bo_tuner.cli.found import fault, note
from bo_tuner.cli.parameter_runs import show_effects, try_parameters
from bo_tuner.cli.streams import say_error
from bo_tuner.cli.study_on_nodes import MistakesError, heard_of_others, hold_against, is_running
from bo_tuner.cli.study_options import (
    add_attach_argument,
    add_bounds_argument,
    add_budget_arguments,
    changed_study,
    read_study,
)
from bo_tuner.cli.test_runs import show_metrics, show_signals
from bo_tuner.errors import BackendError, RunError
from bo_tuner.evidence.check import (
    KeepsValue,
    NothingMoves,
    RunFailed,
    RunRemark,
    Streamed,
)
from bo_tuner.evidence.words.check import in_words, of_proof, of_run, of_study
from bo_tuner.interruption import Interruption
from bo_tuner.metrics.equal_runs import (
    all_stand,
    from_the_run_before,
    standing,
    uneven_rates,
    unlike_starts,
    unmoved,
)
from bo_tuner.metrics.message_rates import rate_of
from bo_tuner.metrics.recording import Recording
from bo_tuner.monitoring.display import say
from bo_tuner.numerics.seeds import Stream, noise_seed
from bo_tuner.plans import Runs
from bo_tuner.study.ending_early import decided_by
from bo_tuner.study.noiseless import noise_in
from bo_tuner.study.sizing import shortages
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Stage
from bo_tuner.tuning.driver import Driver

DESCRIPTION = """\
Hold a study against its nodes, name every mistake in parameters, contexts,
signals and steps of the run, make two test runs of the default, try what each
tuned parameter moves, and estimate how long the study would take.
"""

EPILOG = """\
Nothing is recorded, and all values of the nodes are restored. Nodes that are
not running are started and ended, if the study says how.

exit codes:
  0    both test runs were completed
  1    the check had to stop (nodes lost or disturbed three times in a row, or
       their guard ended), or an attached node was not restored
  2    bad input: study, option or nodes
  3    a run of the default failed, nothing moved in it, or over their whole
       range no tuned parameter was seen to move a metric
  130  interrupted by Ctrl-C (143: by SIGTERM, 129: the terminal was closed,
       141: the output pipe was closed); all values of the nodes are restored

examples:
  check my_study.yaml
  check my_study.yaml --sensitivity        try the whole range of each parameter
  check my_study.yaml --trials 80          how long would 80 trials take?
  check my_study.yaml --no-attach          on nodes that the study starts
  check my_study.yaml --ros-args -r __ns:=/x_axis     nodes in a namespace
"""

RUNS = 2


def make_parser() -> Parser:
    """Return the parser of the command line."""
    parser = Parser("check", DESCRIPTION, EPILOG)
    parser.add_argument("study", metavar="STUDY", help="study file, or name of a shipped study")
    changes = parser.add_argument_group("the study")
    add_budget_arguments(changes)
    add_bounds_argument(changes)
    nodes = parser.add_argument_group("nodes and test runs")
    add_attach_argument(nodes)
    nodes.add_argument(
        "--sensitivity",
        action=argparse.BooleanOptionalAction,
        help="try the whole range of each tuned parameter, or with --no-sensitivity none (default: "
        "the whole range on nodes that the check starts, small steps from the default on nodes "
        "that run already)",
    )
    return parser


@guarded
def run(argv: Sequence[str], interruption: Interruption) -> int:
    """Run the command: a `common.Run`."""
    own, ros_arguments = split_ros_arguments(argv)
    arguments = make_parser().parse_args(own)
    attach: bool | None = arguments.attach
    study = read_study(arguments.study, attach is not False, ros_arguments, interruption)
    return check_study(
        changed_study(study, arguments, named_namespace(ros_arguments)),
        ros_arguments,
        interruption,
        attach=attach,
        sensitivity=arguments.sensitivity,
    )


def check_study(
    study: Study,
    ros_arguments: Sequence[str],
    interruption: Interruption,
    *,
    attach: bool | None = None,
    sensitivity: bool | None = None,
) -> int:
    """Check a study on its nodes; returns the exit code."""
    if attach is None:
        attach = is_running(study, ros_arguments, interruption)
        if not attach:
            say("no node of the study is running: the check starts them, and ends them")
    try:
        if attach:
            with opened_node(ros_arguments, interruption.check) as tuner:
                hold_against(study, tuner, attached=True)
        return _try(study, attach, sensitivity, ros_arguments, interruption)
    except MistakesError:
        return EXIT_USAGE


def _try(
    study: Study,
    attach: bool,
    sensitivity: bool | None,
    ros_arguments: Sequence[str],
    interruption: Interruption,
) -> int:
    """Run the default a few times, and try each parameter; shows what came out.

    These are signals and metrics, what each parameter moves, and how long a study will take.
    """
    with _log_folder(keep=not attach) as folder:
        backend = RosBackend(
            study,
            folder,
            attach=attach,
            keep_parked=False,
            guard=attach or study.guard.always,
            ros_arguments=list(ros_arguments),
            interrupted=interruption.check,
        )
        heard: list[str] = []

        def look(tuner: TunerNode) -> None:
            signals = heard_of_others(study, tuner)
            heard.extend(name for name, spec in signals.items() if spec.is_number)
            if not attach:
                hold_against(study, tuner, attached=False)
            find_answers(study, tuner)

        backend.at_nodes = look
        acts = True
        with opened(backend, interruption) as left:
            done, recordings = _runs(study, backend)
            complete = [e for e in done if e.outcome.complete]
            sound = _show_runs(study, done, recordings, heard)
            if sound and sensitivity is not False:
                whole_range = bool(sensitivity) or not attach
                acts = _try_parameters(study, backend, complete, whole_range=whole_range)
        if complete:
            show_times(study, complete)
        code = ended(left, EXIT_OK if sound and acts else EXIT_INFEASIBLE)
        if code == EXIT_OK:
            shutil.rmtree(folder)
        return code


def _show_runs(
    study: Study,
    done: Sequence[Evaluation],
    recordings: Sequence[Recording],
    heard: Sequence[str],
) -> bool:
    """Show runs of the default; returns whether all are complete, and something moves."""
    show_signals(recordings[-1], RUNS)
    for name, stream in done[-1].outcome.notes.streams.items():
        say(in_words(Streamed(name, stream)))
    failed = [e for e in done if not e.outcome.complete]
    for evaluation in failed:
        fault(RunFailed(evaluation.index + 1, evaluation.outcome.reason))
    for evaluation in done:
        if remark := evaluation.outcome.notes.remark:
            note(RunRemark(evaluation.index + 1, remark))
    if complete := [e for e in done if e not in failed]:
        show_metrics(study, complete)
    if study.budget.cut_short:
        say(in_words(decided_by(study)))
    if (noise := noise_in(study, complete)) is not None:
        fault(noise)
        return False
    # Of a run that failed, nothing may be known.
    return not failed and _show_motion(study, done, recordings, heard)


def _try_parameters(
    study: Study, backend: RosBackend, done: Sequence[Evaluation], *, whole_range: bool
) -> bool:
    """Try each parameter, and show what it moves; returns whether any moves a metric."""
    planned, runs = try_parameters(
        study, Driver(backend), done, whole_range=whole_range, wait=_seconds(done)
    )
    return show_effects(study, planned, runs, whole_range=whole_range)


def _seconds(complete: Sequence[Evaluation]) -> float:
    """Return the mean time [s] of runs."""
    return float(np.mean([evaluation.seconds for evaluation in complete]))


@contextlib.contextmanager
def _log_folder(*, keep: bool) -> Iterator[Path]:
    """Give a folder for what nodes print; what is left of it stays, and is named, to be read."""
    folder = Path(tempfile.mkdtemp(prefix="bo_tuner-check-"))
    try:
        yield folder
    except BaseException as error:
        # A mistake in the study is no fault of the nodes; nor is an interruption.
        keep = keep and isinstance(error, (BackendError, RunError))
        raise
    finally:
        logs = sorted(folder.glob("*.log")) if folder.exists() and keep else []
        if logs:
            say_error(f"what the nodes have printed is in {folder}")
        else:
            shutil.rmtree(folder, ignore_errors=True)


def _runs(study: Study, backend: RosBackend) -> tuple[list[Evaluation], list[Recording]]:
    """Run the default a few times, in the nominal context."""
    contexts = study.context_space()
    nominal = contexts.to_dict(contexts.nominal())
    defaults = study.search_space().defaults
    planned = [
        Evaluation(
            0, k, Stage.NOMINAL, defaults, nominal, noise_seed(study.seed, Stream.NOISE, 0, k)
        )
        for k in range(RUNS)
    ]
    done: list[Evaluation] = []
    recordings = []
    for task in Driver(backend).run(Runs(planned, "runs")):
        done.append(task.evaluation)
        recordings.append(backend.recording)
        if len(done) == RUNS - 1:
            # Each other parameter set restarts such nodes, too.
            backend.start_anew()
    return done, recordings


def _show_motion(
    study: Study,
    done: Sequence[Evaluation],
    recordings: Sequence[Recording],
    heard: Sequence[str],
) -> bool:
    """Show what may be wrong with the signals of complete runs; returns whether any moves."""
    still = standing(recordings, heard)
    if all_stand(recordings, heard):
        fault(NothingMoves(tuple(still), RUNS))
        return False
    last = {name: float(recordings[0].signals[name].value[-1]) for name in still}
    note(*(KeepsValue(name, value, RUNS) for name, value in last.items()))
    note(*unmoved(study, recordings[-1], heard))
    note(*from_the_run_before(recordings, heard))
    note(*unlike_starts(recordings, heard))
    rates = [{name: rate_of(r.signals[name], r.end) for name in heard} for r in recordings]
    numbered = [f"run {number}" for number in range(1, RUNS + 1)]
    note(*uneven_rates(numbered, rates, [e.outcome.load for e in done]).values())
    return True


def show_times(study: Study, complete: Sequence[Evaluation]) -> None:
    """Show how long tuning and certificate will take, by test runs that completed."""
    time = time_of(study, complete)
    for line in (*of_run(time), of_study(time)):
        say(line)
    note(*shortages(study))
    say(of_proof(time))
