"""``tune``: run a study, or resume a run, and report the result."""

import argparse
import dataclasses
import importlib.util
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bo_tuner.backends.ros.isolation import named_namespace, namespace_of
from bo_tuner.backends.ros.processes import has_executable
from bo_tuner.backends.workers.workers import Workers
from bo_tuner.cli import validate
from bo_tuner.cli.common import (
    RUNS,
    Parser,
    allow_programs,
    attached,
    guarded,
    in_namespace_of,
    read_result,
    recorded_backend,
    run_folder,
    split_ros_arguments,
)
from bo_tuner.cli.confirm import NO_TERMINAL
from bo_tuner.cli.exit_codes import EXIT_FAULT, EXIT_INFEASIBLE, EXIT_OK, early_end
from bo_tuner.cli.notify import notify
from bo_tuner.cli.session import RunOptions, Session
from bo_tuner.cli.streams import say_error
from bo_tuner.cli.study_options import changed_study, read_study, trust_given
from bo_tuner.cli.tune_options import STUDY, make_parser
from bo_tuner.cli.workers import workers_of
from bo_tuner.errors import BoTunerError, StudyError
from bo_tuner.interruption import Interrupted, Interruption
from bo_tuner.method_names import SAFE
from bo_tuner.methods.registry import METHODS, method_of, problem_of
from bo_tuner.monitoring.display import Output, plain_console
from bo_tuner.recording.retention import Policy, RecordOptions
from bo_tuner.replay.recompute import measure_again
from bo_tuner.storage.provenance import SIMULATION_FROM, SIMULATION_TAKEN
from bo_tuner.storage.record import RunRecord, read_run
from bo_tuner.storage.run_folder import RunFolder
from bo_tuner.storage.trust import is_trusted
from bo_tuner.study.ending_early import check_ends_early
from bo_tuner.study.parts import BACKENDS, ROS
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import load_study, shipped_studies
from bo_tuner.terminal import from_here, print_line
from bo_tuner.trials import count_evaluations, count_trials
from bo_tuner.tuning.carrying import (
    Carried,
    carry_over,
    check_comparable,
    is_carried,
    remeasured,
)
from bo_tuner.tuning.simulated_runs import begun_by_simulation, take_simulation
from bo_tuner.web.address import listen

FROM_THE_RECORD = ("study", "seed", "output", "backend", "algorithm", "start")
"""Options that a resumed run takes from its record."""


@dataclass(frozen=True)
class Plan:
    """What to run.

    Attributes
    ----------
    study, algorithm, backend, attach, stop_early
        Passed on in the options of the run.
    resumed
        The run that it continues.
    carried
        What it takes of an earlier run.
    simulation
        What it knows of a simulation.
    """

    study: Study
    algorithm: str
    backend: str
    attach: bool
    stop_early: bool
    resumed: RunRecord | None = None
    carried: Carried | None = None
    simulation: Carried | None = None


@guarded
def run(argv: Sequence[str], interruption: Interruption) -> int:
    """Run the command: a `common.Run`."""
    own, ros_arguments = split_ros_arguments(argv)
    parser = make_parser()
    arguments, unknown = parser.parse_known_args(own)
    if unknown:
        only_a_study = len(unknown) == 1 and not unknown[0].startswith("-")
        hint = f"; did you mean --study {unknown[0]}?" if only_a_study else ""
        parser.error(f"unrecognized arguments: {' '.join(unknown)}{hint}")
    return _run(arguments, parser, ros_arguments, interruption)


def _run(
    arguments: argparse.Namespace,
    parser: Parser,
    ros_arguments: Sequence[str],
    interruption: Interruption,
) -> int:
    if arguments.simulated and arguments.earlier is None:
        parser.error("--simulated needs --from: the run of the simulation")
    if arguments.resume is not None:
        _refuse_beside_resume(arguments, parser)
        record = read_run(run_folder(arguments.resume))
        plan = _resumed(record, arguments, parser)
        ros_arguments = _resumed_in(record, plan.attach, ros_arguments, parser)
    elif arguments.simulated:
        simulated = _earlier(arguments)
        plan = _after_simulation(simulated, arguments, parser, ros_arguments, interruption)
    elif arguments.earlier is not None:
        record = _earlier(arguments)
        ros_arguments = in_namespace_of(record, ros_arguments)
        plan = _after_earlier(record, arguments, parser, ros_arguments, interruption)
    else:
        plan = _new(arguments, parser, ros_arguments, interruption)
    workers = workers_of(
        arguments,
        parser,
        plan.study,
        plan.backend,
        attach=plan.attach,
        ros_arguments=ros_arguments,
        known=None if plan.resumed is None else plan.resumed.options,
    )
    _check_options(plan, arguments, parser, workers)
    options = RunOptions(
        algorithm=plan.algorithm,
        backend=plan.backend,
        attach=plan.attach,
        ros_arguments=ros_arguments,
        record=_recording(arguments, plan.resumed),
        output=arguments.output_mode,
        stop_early=plan.stop_early,
        workers=workers,
        more=plan.resumed is not None
        and not (arguments.trials is None and arguments.evaluations is None),
        time=arguments.time,
        carried=plan.carried,
        simulation=plan.simulation,
        web=None if arguments.web is None else listen(arguments.web, arguments.web_host),
        web_control=arguments.web_control,
        confirm=arguments.confirm,
        certify=arguments.certify,
    )
    if plan.resumed is not None:
        folder = RunFolder(plan.resumed.path.resolve())
    else:
        folder = RunFolder.create(arguments.output or RUNS, plan.study)
    try:
        session = Session(plan.study, folder, options, interruption)
        code = session.run()
    except BaseException:
        folder.discard()
        raise
    if arguments.certify and code == EXIT_OK and not arguments.time.over:
        try:
            return _certify(arguments, folder.path, ros_arguments, interruption)
        except (BoTunerError, Interrupted) as error:
            # Such as of nodes that are gone between the run and its certificate.
            said, code = early_end(error)
            headline = f"no certificate: {said}; continue with: validate {from_here(folder.path)}"
            session.warn(headline)
            notify(arguments.notify, folder.path, code, headline, session.warn)
            return code
    headline = session.headline
    if arguments.certify and code in (EXIT_OK, EXIT_INFEASIBLE):
        why = headline
        if code == EXIT_OK:
            code, why = EXIT_FAULT, f"no time is left for it; validate {folder.path} makes it"
        headline = f"no certificate: {why}"
        session.warn(headline)
    notify(arguments.notify, folder.path, code, headline, session.warn)
    return code


def _certify(
    arguments: argparse.Namespace,
    run_path: Path,
    ros_arguments: Sequence[str],
    interruption: Interruption,
) -> int:
    """Certify the result of a run in the time that is left, as ``validate``; returns its code."""
    limit, address = arguments.time, arguments.scheduler
    command = [str(run_path)]
    if not limit.endless:
        command += ["--time", f"{max(limit.left, 0.001):.3f}s"]
    if address is not None:
        # Of a cluster, a run says nothing for others.
        count = read_run(run_path).options.workers
        command += ["--scheduler", address, "--workers", str(count)]
    if arguments.notify is not None:
        command += ["--notify", arguments.notify]
    code = validate.certify([*command, *ros_arguments], interruption)
    if not limit.endless:
        print_line(plain_console(stderr=True), f"{limit.outcome}, with the certificate", "  ")
    return code


def _recording(arguments: argparse.Namespace, resumed: RunRecord | None) -> RecordOptions:
    """Return which bags to keep: what the user says, else what an earlier session of the run did.

    The bags of that session count, too: a lower limit would delete them.
    """
    policy, limit = arguments.record, arguments.record_limit
    if resumed is not None:
        known = resumed.options
        policy = policy or (known.record if known.record in list(Policy) else None)
        limit = known.record_limit if limit is None else limit
    default = RecordOptions()
    return RecordOptions(
        Policy(policy or default.policy), default.limit if limit is None else limit
    )


def _refuse_beside_resume(arguments: argparse.Namespace, parser: Parser) -> None:
    if arguments.earlier is not None:
        parser.error("--resume continues a run, --from begins a new one; leave one out")
    given = [name for name in FROM_THE_RECORD if getattr(arguments, name) is not None]
    if given:
        parser.error(f"--resume takes --{given[0]} from the run's record; leave it out")
    if arguments.bounds:
        parser.error("--resume goes on with the bounds of the run; --from begins a new run")
    if arguments.fix:
        parser.error("--resume goes on with the parameters of the run; --from begins a new run")


def _resumed(record: RunRecord, arguments: argparse.Namespace, parser: Parser) -> Plan:
    """Plan the rest of a run, or more of it."""
    study, backend = record.study, recorded_backend(record)
    attach = attached(arguments, parser, backend, record)
    allow_programs(record, trusted=arguments.trust, attach=attach)
    stop_early = arguments.stop_early or record.options.stop_early
    if arguments.trials is not None or arguments.evaluations is not None:
        _check_more(arguments, record, parser)
        # Who asks for more trials does not want the earlier advice to stop.
        study = changed_study(study, arguments, record.options.namespace)
        stop_early = arguments.stop_early
    known = None
    if record.simulation:
        origin = record.provenance
        known = Carried(origin[SIMULATION_FROM], record.simulation, origin[SIMULATION_TAKEN])
    return Plan(
        study, record.algorithm, backend, attach, stop_early, resumed=record, simulation=known
    )


def _earlier(arguments: argparse.Namespace) -> RunRecord:
    """Read the run of --from, and warn if what is left of it is not all."""
    folder = run_folder(arguments.earlier)
    record = read_result(folder) if arguments.simulated else read_run(folder)
    if record.damage:
        say_error(f"warning: the record of --from was damaged: {record.damage}")
    return record


def _after_earlier(
    record: RunRecord,
    arguments: argparse.Namespace,
    parser: Parser,
    ros_arguments: Sequence[str],
    interruption: Interruption,
) -> Plan:
    """Plan a run that begins with the trials of an earlier one."""
    backend = recorded_backend(record)
    attach = attached(arguments, parser, backend, record)
    for name, recorded in (("backend", record.backend), ("algorithm", record.algorithm)):
        if getattr(arguments, name) not in (None, recorded):
            parser.error(f"--{name}: expected {recorded}, as in the run of --from; leave it out")
    if arguments.study is not None:
        study = _given(arguments.study, attach, arguments, ros_arguments, interruption)
    else:
        study = changed_study(record.study, arguments, named_namespace(ros_arguments))
        allow_programs(record, trusted=arguments.trust, attach=attach)
        if is_trusted(record.study):
            # With other bounds it names the same programs.
            trust_given(study)
    if problem := problem_of(record.algorithm, study):
        parser.error(f"--from: {problem}")
    check_ends_early(study, backend)
    # What that run knew of a simulation is not taken along.
    method = METHODS[record.algorithm]
    check_comparable(record, study, method)
    measure = measure_again(record, study) if remeasured(record.study, study) else None
    carried = carry_over(record, study, method, measure)
    if all(given is None for given in (arguments.study, arguments.trials, arguments.evaluations)):
        study = _as_much_again(record, study, carried)
    _check_budget(study, carried, parser)
    return Plan(study, record.algorithm, backend, attach, arguments.stop_early, carried=carried)


def _after_simulation(
    simulated: RunRecord,
    arguments: argparse.Namespace,
    parser: Parser,
    ros_arguments: Sequence[str],
    interruption: Interruption,
) -> Plan:
    """Plan a run on a machine that knows the trials of its simulation."""
    if arguments.study is None:
        parser.error("--simulated needs --study: that of the machine")
    plan = _new(arguments, parser, ros_arguments, interruption)
    method = METHODS[plan.algorithm]
    if problem := method.simulation_problem(plan.study):
        parser.error(f"--simulated: {plan.algorithm} {problem}")
    known = take_simulation(simulated, plan.study, method)
    study = begun_by_simulation(plan.study, simulated, known)
    return dataclasses.replace(plan, study=study, simulation=known)


def _as_much_again(record: RunRecord, study: Study, carried: Carried) -> Study:
    """Return the study with a budget for as much as a run had itself, beside what is taken of it.

    The budget of a study counts all trials, also those that the run had taken from another one.
    """
    budget, taken = record.study.budget, carried.trials
    had = [trial for trial in record.trials if is_carried(trial)]
    trials = budget.trials - count_trials(had) + count_trials(taken)
    evaluations = budget.evaluations
    if evaluations is not None:
        evaluations += count_evaluations(taken) - count_evaluations(had)
    return study.replace(trials=trials, evaluations=evaluations)


def _new(
    arguments: argparse.Namespace,
    parser: Parser,
    ros_arguments: Sequence[str],
    interruption: Interruption,
) -> Plan:
    """Plan a run of its own."""
    named = STUDY if arguments.study is None else arguments.study
    backend = arguments.backend or BACKENDS[0]
    attach = attached(arguments, parser, backend, None)
    if named in shipped_studies() and not attach:
        _check_installed(load_study(named), backend)
    study = _given(named, attach, arguments, ros_arguments, interruption)
    algorithm = arguments.algorithm or method_of(study)
    if problem := problem_of(algorithm, study):
        parser.error(f"{'safe_search' if algorithm == SAFE else '--algorithm'}: {problem}")
    check_ends_early(study, backend)
    return Plan(study, algorithm, backend, attach, arguments.stop_early)


def _check_installed(study: Study, backend: str) -> None:
    """Refuse a shipped study if its nodes are not installed, and say what to do instead."""
    for spec in study.nodes.values():
        if backend == ROS:
            package = spec.package or ""
            installed = has_executable(package, spec.executable or "")
        else:
            package = (spec.object or "").partition(".")[0]
            installed = importlib.util.find_spec(package) is not None
        if not installed:
            raise StudyError(
                f"the shipped study {study.name} needs the package {package}, which is not "
                "installed; for nodes of your own write a study with init my_study.yaml, and run "
                "tune --study my_study.yaml --attach"
            )


def _given(
    named: str,
    attach: bool,
    arguments: argparse.Namespace,
    ros_arguments: Sequence[str],
    interruption: Interruption,
) -> Study:
    """Read the study that the user has given to be run, and trust it."""
    loaded = read_study(named, attach, ros_arguments, interruption)
    study = changed_study(loaded, arguments, named_namespace(ros_arguments))
    trust_given(study)
    return study


def _resumed_in(
    record: RunRecord, attach: bool, ros_arguments: Sequence[str], parser: Parser
) -> list[str]:
    """Return the ``--ros-args`` of the rest of a run, which is on the same nodes."""
    arguments, recorded = in_namespace_of(record, ros_arguments), record.options.namespace
    namespace = namespace_of(arguments)
    if attach and record.options.attached and recorded and namespace != recorded:
        parser.error(
            f"--resume: the run is of nodes in the namespace {recorded}, not {namespace}; --from "
            "begins a new run with its trials"
        )
    return arguments


def _check_options(
    plan: Plan, arguments: argparse.Namespace, parser: Parser, workers: Workers
) -> None:
    """Refuse options that do not go with the run."""
    if plan.stop_early and len(plan.study.objectives) > 1:
        parser.error("--stop-early: expected a study with one objective; leave it out")
    if arguments.confirm:
        if plan.algorithm != SAFE:
            parser.error("--confirm: expected a study with `safe_search: true`")
        if workers.window > 1:
            parser.error(f"--confirm: expected 1 worker, found {workers.window}")
        if arguments.output_mode is Output.JSON_LINES:
            parser.error("--confirm: asks in words; leave --json-lines out")
        answers_elsewhere = arguments.web_control or plan.backend == ROS
        if not sys.stdin.isatty() and not answers_elsewhere:
            parser.error(f"--confirm: {NO_TERMINAL}")
    if arguments.certify and arguments.output_mode is Output.JSON_LINES:
        parser.error("--certify: tells its verdict in words; leave --json-lines out")
    if arguments.web_control and arguments.web is None:
        parser.error("--web-control needs --web")
    if arguments.web_host is not None and arguments.web is None:
        parser.error("--web-host needs --web")
    if arguments.record not in (None, Policy.NONE) and plan.backend != ROS:
        parser.error("--record needs --backend ros: without nodes there are no messages")


def _check_more(arguments: argparse.Namespace, record: RunRecord, parser: Parser) -> None:
    """Refuse a budget that a run has used up already, or was to have anyway."""
    trials, evaluations = record.study.budget.trials, record.study.budget.evaluations
    done = count_evaluations(record.trials)
    if evaluations is not None or record.finished is not None:
        # The run may have ended before its last trial.
        trials = count_trials(record.trials)
    if record.finished is not None:
        evaluations = None
    for name, given, had in (
        ("trials", arguments.trials, trials),
        ("evaluations", arguments.evaluations, max(done, evaluations or 0)),
    ):
        if given is not None and given <= had:
            parser.error(f"--{name}: expected more than the {had} of the run, found {given}")


def _check_budget(study: Study, carried: Carried, parser: Parser) -> None:
    """Refuse a budget that the trials taken from an earlier run use up."""
    trials, evaluations = count_trials(carried.trials), count_evaluations(carried.trials)
    budget = study.budget
    if not budget.is_spent(trials, evaluations):
        return
    name, most, taken = "trials", budget.trials, trials
    if budget.evaluations is not None and evaluations >= budget.evaluations:
        name, most, taken = "evaluations", budget.evaluations, evaluations
    parser.error(f"--{name}: expected more than the {taken} of --from, found {most}")
