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
from bo_tuner.backends.ros.safe_state import parks_after_runs
from bo_tuner.backends.ros.tuner_node import TunerNode
from bo_tuner.cli.answers import find_answers
from bo_tuner.cli.common import Parser, ended, guarded, opened, split_ros_arguments
from bo_tuner.cli.exit_codes import EXIT_INFEASIBLE, EXIT_OK, EXIT_USAGE
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
from bo_tuner.evidence.certificate.certification import most_evaluations
from bo_tuner.evidence.certificate.draws import least_draws
from bo_tuner.evidence.certificate.judgement import least_evaluations
from bo_tuner.evidence.certificate.outlook import probable_certificate
from bo_tuner.evidence.certificate.plan import Subject
from bo_tuner.evidence.certificate.store import required_draws
from bo_tuner.evidence.next_drive import asked_of, least_drives
from bo_tuner.interruption import Interruption
from bo_tuner.methods.registry import METHODS, method_of
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
from bo_tuner.numerics.sequential import spent
from bo_tuner.plans import Runs
from bo_tuner.run_notes import Published
from bo_tuner.study.ending_early import decided_by
from bo_tuner.study.noiseless import noise_in
from bo_tuner.study.sizing import shortages
from bo_tuner.study.study import Study
from bo_tuner.text import counted, duration, durations, shown
from bo_tuner.trials import TUNED, Evaluation, Stage
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
            _estimate(study, complete)
        code = ended(left, EXIT_OK if sound and acts else EXIT_INFEASIBLE)
        if code == EXIT_OK:
            shutil.rmtree(folder)
        return code


def _in_words(stream: Published) -> str:
    return (
        f"{stream.messages} messages, {stream.left_out} left out, late by "
        f"{stream.late * 1e3:.2f} ms on average and {stream.latest * 1e3:.2f} ms at most, longest "
        f"gap {stream.gap * 1e3:.1f} ms"
    )


def _show_runs(
    study: Study,
    done: Sequence[Evaluation],
    recordings: Sequence[Recording],
    heard: Sequence[str],
) -> bool:
    """Show runs of the default; returns whether all are complete, and something moves."""
    show_signals(recordings[-1], RUNS)
    for name, stream in done[-1].outcome.notes.streams.items():
        say(f"stream on {name}: {_in_words(stream)}")
    failed = [e for e in done if not e.outcome.complete]
    for evaluation in failed:
        say_error(
            f"error: run {evaluation.index + 1} of the default failed: {evaluation.outcome.reason}"
        )
    for evaluation in done:
        if remark := evaluation.outcome.notes.remark:
            say(f"note: run {evaluation.index + 1}: {remark}")
    if complete := [e for e in done if e not in failed]:
        show_metrics(study, complete)
    if study.budget.cut_short:
        say(decided_by(study))
    if noise := noise_in(study, complete):
        say_error(f"error: {noise}")
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
    if all_stand(recordings, heard):
        say_error(
            f"error: nothing moves: {', '.join(standing(recordings, heard))} did not change in "
            f"{RUNS} runs; see that the machine is switched on, and that run.start sets it going"
        )
        return False
    notes = [
        f"{name}: keeps the value {shown(float(recordings[0].signals[name].value[-1]))} in all "
        f"{RUNS} runs"
        for name in standing(recordings, heard)
    ]
    notes += unmoved(study, recordings[-1], heard)
    notes += from_the_run_before(recordings, heard)
    notes += unlike_starts(recordings, heard)
    rates = [{name: rate_of(r.signals[name], r.end) for name in heard} for r in recordings]
    numbered = [f"run {number}" for number in range(1, RUNS + 1)]
    notes += uneven_rates(numbered, rates, [e.outcome.load for e in done]).values()
    for note in notes:
        say(f"note: {note}")
    return True


def evaluations_at_most(study: Study) -> tuple[int, int]:
    """Return the largest numbers of evaluations of a study and of the certificate of its result."""
    tuning = METHODS[method_of(study)].most_evaluations(study)
    # A trial has a suspected context for each worst-case limit.
    contexts = study.context_space()
    nominal = contexts.to_dict(contexts.nominal())
    suspected = (nominal,) * len(study.worst_case_constraints)
    subject = Subject(TUNED, study.search_space().defaults, suspected)
    draws = required_draws(study, study.certificate.confidence)
    certificate = most_evaluations(study, [subject], draws).total
    # The first run of all is made once more if it is to have no noise.
    tuning += 2 * study.budget.validation_draws + study.is_noiseless
    return tuning, certificate


def _estimate(study: Study, complete: Sequence[Evaluation]) -> None:
    """Show how long tuning and certificate will take, by test runs that completed."""
    notes = [e.outcome.notes for e in complete]
    starting = sum(n.start_seconds for n in notes)
    resting = max(n.rested_seconds for n in notes)
    waiting = starting + sum(n.rested_seconds + n.ramped_seconds for n in notes)
    seconds = (sum(e.seconds for e in complete) - waiting) / len(complete)
    say(f"a test run took {seconds:.3g} s")
    if resting:
        seconds += resting
        say(f"the machine rested {resting:.3g} s ahead of one, which counts")
    ramping_of_run, ramping_of_set = _ramping(study)
    seconds += ramping_of_run
    runs, warming = notes[0].warm_ups, notes[0].warm_up_seconds
    if runs:
        say(f"{counted(runs, 'run')} to warm up took {warming:.3g} s: once for each command")
    if study.relative_metrics:
        seconds *= 2.0
        say(
            "note: limits are relative to the default, which is run beside each test run of "
            "another parameter set: it takes twice the time"
        )
    tuning, certificate = evaluations_at_most(study)
    starts_of_study = 0
    if starting:
        each = _starts_each_time(study)
        starts_of_study = tuning if each else min(tuning, study.budget.trials)
        say(
            f"to {_brought_up(study)} with other values took {starting:.3g} s: "
            f"once for {'each test run' if each else 'each parameter set'}"
        )
    seconds_of_study = tuning * seconds + starts_of_study * starting + warming
    seconds_of_study += min(tuning, study.budget.trials) * ramping_of_set

    def of_certificate(evaluations: int) -> float:
        starts = 0.0 if not starting else evaluations if _starts_each_time(study) else 1.0
        return evaluations * seconds + starts * starting + warming

    say(f"study: at most {counted(tuning, 'test run')}, {duration(seconds_of_study)}")
    for line in shortages(study):
        say(f"note: {line}")
    if study.plays_bags:
        least = least_drives(asked_of(study), spent(study.certificate.confidence, 1))
        say(f"proof: validate --drives with at least {least} drives that are not in the study")
        return
    at_most = f"at most {certificate}, {duration(of_certificate(certificate))}"
    if (probable := probable_certificate(study)) is not None:
        fewest = least_evaluations(study, spent(study.certificate.confidence, 1))
        least = max(fewest, least_draws(study))
        times = durations(of_certificate(probable.low), of_certificate(probable.high))
        say(
            f"certificate: probably {probable} test runs, {times}, if the result passes by a "
            f"usual margin; at least {least}, {at_most}"
        )
    else:
        say(f"certificate: {at_most}; fewer once the verdict is clear")


def _ramping(study: Study) -> tuple[float, float]:
    """Show how long ramps take; returns it [s] for each test run, and for each parameter set."""
    ramp = None if study.run is None else study.run.ramp
    if ramp is None:
        return 0.0, 0.0
    # The default beside a run, or the safe parameters after it, change them even within a trial.
    count = 2 if parks_after_runs(study) else 1 if study.relative_metrics else 0
    often = ("once for each parameter set", "once for each test run", "twice for each test run")
    say(f"a ramp takes {ramp:g} s, {often[count]}, which counts")
    return count * ramp, 0.0 if count else ramp


def _brought_up(study: Study) -> str:
    """Return what is done with nodes that take values while they start, or are configured."""
    start: list[str] = []
    configure: list[str] = []
    for key, spec in study.nodes.items():
        if any(spec.names_in_braces):
            start.append(key)
        elif key in study.start_names:
            (configure if spec.reconfigure else start).append(key)
    verbs = (("start", start), ("configure", configure))
    return " and ".join(f"{verb} {', '.join(keys)}" for verb, keys in verbs if keys)


def _starts_each_time(study: Study) -> bool:
    """Whether a node takes contexts or seeds only while it starts, as it does the parameters."""
    in_braces = {name for spec in study.nodes.values() for _, name in spec.names_in_braces}
    if in_braces & study.contexts.keys():
        return True
    targets = [(item.node, item.parameter) for item in study.contexts.values()]
    if study.seed_parameter is not None:
        targets.append((study.seed_parameter.node, study.seed_parameter.parameter))
    return any(name in study.start_names.get(node, ()) for node, name in targets)
