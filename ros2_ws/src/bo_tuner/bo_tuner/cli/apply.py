"""``apply``: set the result of a run on live nodes, or their previous values."""

import contextlib
import os
import shlex
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rich.table import Table

from bo_tuner.backends.ros.isolation import named_namespace
from bo_tuner.backends.ros.parameters.note import said_of_killed
from bo_tuner.cli.common import (
    Parser,
    guarded,
    in_namespace_of,
    read_result,
    split_ros_arguments,
    trial_of,
    whole_number,
)
from bo_tuner.cli.exit_codes import EXIT_FAULT, EXIT_INFEASIBLE, EXIT_OK, EXIT_USAGE
from bo_tuner.cli.streams import confirmed, output_was_closed, say_error
from bo_tuner.cli.write_back import PREVIOUS, write_back
from bo_tuner.codec import checks
from bo_tuner.deploy.apply import (
    ApplyError,
    NodeError,
    Way,
    read_values,
    set_values,
)
from bo_tuner.deploy.bundle import (
    DEPLOY,
    PARAMETERS,
    ROLLBACK,
    UNFINISHED,
    Difference,
    before_run,
    differences,
    read_rollback,
    result_of,
    write_bundle,
)
from bo_tuner.deploy.live_parameters import LiveParameters
from bo_tuner.errors import BackendError
from bo_tuner.evidence.certificate.store import certificate_problem
from bo_tuner.evidence.next_drive import drives_problem
from bo_tuner.interruption import Interrupted, Interruption
from bo_tuner.monitoring.display import plain_console, say
from bo_tuner.storage.atomic import write_atomically
from bo_tuner.storage.parameter_file import (
    NodeValues,
    all_values,
    node_values,
    sent_values,
    to_yaml,
)
from bo_tuner.storage.record import RunRecord
from bo_tuner.storage.run_folder import RunFolder
from bo_tuner.study.safe_values import named_safe
from bo_tuner.study.study import Study
from bo_tuner.terminal import print_table
from bo_tuner.text import brief, shown
from bo_tuner.trials import Trial

DESCRIPTION = """\
Set the result of a run on live nodes: shows what would change, asks, sets all
values or none, reads them back, and saves the previous values in
RUN/deploy/rollback.yaml. The result needs a certificate: a PASS for this study,
these parameters and this code, with the test runs and confidence that the
study requires, and no later FAIL.

With --write FILE the result goes into the parameter file that the nodes start
with instead: only its values change, the previous file is kept beside it.

Nothing is set on nodes that take parameters only while they start (at_start in
the study): the file to start them with is named, and that a start is needed.
Those that take them when they are configured (reconfigure) are configured anew.
"""

EPILOG = """\
The nodes are looked for in the domain and with the discovery settings of the
environment (ROS_DOMAIN_ID), and in the namespace of the run unless --ros-args
name another.

exit codes:
  0    the nodes have the values, as read back from them, or the file has them
  1    a node refused, did not answer or read back another value; the previous
       values were restored, or the message names the node where that failed
  2    bad input: run, option, nodes or file, or no terminal to confirm on
  3    nothing was set: no certificate allows it, you did not confirm, or the
       nodes' values or the file changed before you did
  130  interrupted by Ctrl-C before anything was set, or in a ramp, and the
       previous values were restored (143: by SIGTERM, 129: the terminal was
       closed)
  141  if the output pipe was closed, 1 if output could not be written; run
       apply again to see the nodes' values

examples:
  apply runs/latest                              show the difference, ask, set
  apply runs/latest --yes                        without asking
  apply runs/latest --trial 12                   another certified parameter set
  apply runs/latest --rollback                   restore the previous values
  apply runs/latest --without-certificate        at your own risk
  apply runs/latest --write nav2_params.yaml     into your own parameter file
  apply runs/latest --ros-args -r __ns:=/x_axis  nodes in a namespace
"""


def make_parser() -> Parser:
    """Return the parser of the command line."""
    parser = Parser("apply", DESCRIPTION, EPILOG)
    parser.add_run_argument("folder of a run that has ended")
    parser.add_argument(
        "--trial",
        type=whole_number,
        metavar="N",
        help="the parameter set of this trial (default: the result of the run)",
    )
    parser.add_argument("--yes", action="store_true", help="set without asking")
    parser.add_argument(
        "--rollback", action="store_true", help=f"set the values of the run's deploy/{ROLLBACK}"
    )
    parser.add_argument(
        "--write",
        type=Path,
        metavar="FILE",
        help="write the values into this parameter file, and set none on nodes; the previous file "
        f"is kept as FILE{PREVIOUS}",
    )
    parser.add_argument(
        "--without-certificate",
        action="store_true",
        help="set the result even if no certificate allows it",
    )
    return parser


@guarded
def run(argv: Sequence[str], interruption: Interruption) -> int:
    """Run the command: a `common.Run`."""
    own, ros_arguments = split_ros_arguments(argv)
    parser = make_parser()
    arguments = parser.parse_args(own)
    if output_was_closed():
        return _refuse("standard output is closed: what would be set cannot be shown", EXIT_FAULT)
    record = read_result(arguments.run)
    # `latest` may name another run by the time that somebody answers.
    record = replace(record, path=record.path.resolve())
    trial = None
    if arguments.rollback:
        if arguments.trial is not None:
            parser.error("--trial and --rollback exclude each other")
    else:
        trial = result_of(record)
        if arguments.trial is not None:
            trial = trial_of(record, arguments.trial)
        by_drives = record.study.plays_bags
        problem = (drives_problem if by_drives else certificate_problem)(record, trial)
        if problem and not arguments.without_certificate:
            return _refuse(f"{problem} (or use --without-certificate)", EXIT_INFEASIBLE)
        if problem:
            _warn(f"{problem}; continuing without")
    # The lock keeps other processes from writing the bundle.
    folder = RunFolder(record.path)
    with contextlib.closing(folder):
        # A continued run has no result yet; what an earlier one replaced can still be restored.
        if record.summary is not None:
            write_bundle(record)
        if trial is None:
            new, title = read_rollback(record), f"back to {DEPLOY}/{ROLLBACK}"
            # Equal to those in the parameter file of a run before anything was set.
            if new == all_values(record.study):
                title += ", the study's default"
            elif new == before_run(record):
                title += ", what ran before tune"
        else:
            new = node_values(record.study, trial.parameters)
            title = f"parameters of trial {trial.number}"
        given = record.study.search_space().defaults if trial is None else trial.parameters
        for line in sent_values(record.study, given):
            say(line)
        if not new:
            say("no node has a parameter of this study: nothing to set")
            return EXIT_OK
        there = in_namespace_of(record, ros_arguments)
        if arguments.write is not None:
            namespace = named_namespace(there)
            return write_back(arguments.write, new, namespace, interruption, yes=arguments.yes)
        # A node that takes some of them only while it starts would run with a mixture.
        at_start = [node for node in _started(record.study) if node in new]
        live = {node: values for node, values in new.items() if node not in at_start}
        if not live:
            return _name_file(record, trial, new, at_start)
        os.environ.setdefault("ROS_LOG_DIR", str(folder.log))
        specs = record.study.nodes.values()
        reconfigured = {spec.node: spec for spec in specs if spec.reconfigure}
        nodes = LiveParameters(list(live), there, interruption.check, reconfigured)
        with contextlib.closing(nodes):
            try:
                now = read_values(nodes, live)
                rows = differences(record.study, now, live)
                _show(rows, f"{record.study.name}: {title}")
                _remark(nodes)
                configured = [*filter(nodes.is_configured, live)]
                if all(row.equal for row in rows) and not configured:
                    # What an earlier one did not finish is so now.
                    (record.path / DEPLOY / UNFINISHED).unlink(missing_ok=True)
                    _forget_killed(nodes, live)
                    say("the nodes already have these values; nothing to set")
                    return _name_file(record, trial, new, at_start)
                if not arguments.yes:
                    if not sys.stdin.isatty():
                        return _refuse("no terminal to confirm on; use --yes", EXIT_USAGE)
                    anew = f", and configure {', '.join(configured)} anew" if configured else ""
                    question = f"set these on {', '.join(live)}{anew}? [y/N] "
                    if not confirmed(question, interruption):
                        say("nothing was set")
                        return EXIT_INFEASIBLE
                    if read_values(nodes, live) != now:
                        return _refuse("the nodes' values have changed meanwhile", EXIT_INFEASIBLE)
            except NodeError as error:
                raise BackendError(str(error)) from error
            with nodes.guarded(record.study, now, folder.log):
                code = _set(record, trial, nodes, now, live, ros_arguments, interruption)
            return _name_file(record, trial, new, at_start) if code == EXIT_OK else code


def _started(study: Study) -> list[str]:
    """Return the names of the nodes that take some parameters only while they start."""
    nodes = (study.nodes[key] for key in study.start_names)
    return [spec.node for spec in nodes if not spec.reconfigure]


def _name_file(
    record: RunRecord, trial: Trial | None, values: NodeValues, at_start: Sequence[str]
) -> int:
    """Name the parameter file for nodes that must be started with it; returns the exit code."""
    if not at_start:
        return EXIT_OK
    folder = record.path / DEPLOY
    if trial is None:
        file = folder / ROLLBACK
    elif trial.number == result_of(record).number:
        file = folder / PARAMETERS
    else:
        file = write_atomically(folder / f"trial_{trial.number}.yaml", to_yaml(values))
    names = ", ".join(at_start)
    command = ["apply", str(record.path), "--write", "FILE"]
    command[2:2] = ["--rollback"] if trial is None else ["--trial", str(trial.number)]
    say(
        f"nothing was set on {names}, which takes its parameters only while it starts: restart it "
        f"with --ros-args --params-file {file}, or first put them into its own file: "
        f"{shlex.join(command)}"
    )
    return EXIT_OK


def _set(
    record: RunRecord,
    trial: Trial | None,
    nodes: LiveParameters,
    now: NodeValues,
    new: NodeValues,
    ros_arguments: Sequence[str],
    interruption: Interruption,
) -> int:
    """Set the values of a trial, or without one those to roll back to."""
    folder = record.path
    rollback = folder / DEPLOY / ROLLBACK
    unfinished = folder / DEPLOY / UNFINISHED
    was_unfinished = unfinished.exists()
    if was_unfinished and trial is not None:
        _warn(f"an earlier apply did not finish; {rollback} keeps what the nodes had before it")
    elif trial is not None:
        write_bundle(record, rollback=_rollback(record, nodes, now))

    def commit() -> None:
        # From here on it is all or nothing.
        interruption.ignore()
        interruption.check()

    write_atomically(unfinished, f"nodes may have values of an apply that did not finish: {new}\n")
    try:
        set_values(nodes, now, new, Way.of(record.study, now, new), commit)
    except Interrupted:
        if not was_unfinished:
            unfinished.unlink()
        raise
    except ApplyError as error:
        if error.restored and not was_unfinished:
            unfinished.unlink()
        saved = "" if trial is None else f"; the previous values are in {rollback}"
        return _refuse(f"{error}{saved}", EXIT_FAULT)
    unfinished.unlink()
    _forget_killed(nodes, new)
    _remark(nodes)
    configured = [*filter(nodes.is_configured, new)]
    anew = f"; in force: {', '.join(configured)} was configured anew" if configured else ""
    say(f"set and read back on {', '.join(new)}{anew}")
    if trial is not None:
        command = shlex.join(["apply", str(folder), "--rollback", *ros_arguments])
        say(f"previous values: {rollback}; restore them with: {command}")
        if (result := result_of(record)).number != trial.number:
            say(
                f"{folder / DEPLOY / PARAMETERS} holds trial {result.number}, the result; for the "
                "next start of the nodes, save what they have now with: ros2 param dump"
            )
    return EXIT_OK


def _remark(nodes: LiveParameters) -> None:
    for remark in nodes.take_remarks():
        _warn(remark)


def _forget_killed(nodes: LiveParameters, values: NodeValues) -> None:
    """Let the nodes keep values that a user has set, also where they are a killed run's."""
    for node, of_node in values.items():
        nodes.forget_killed(node, of_node)


def _rollback(record: RunRecord, nodes: LiveParameters, now: NodeValues) -> NodeValues:
    """Return what nodes had; of those that nothing is set on, what they had before the run."""
    before = before_run(record)
    if before is None:
        before = all_values(record.study)
    return {**before, **_own(record, nodes, now)}


def _own(record: RunRecord, nodes: LiveParameters, now: NodeValues) -> NodeValues:
    """Return what the nodes have, without what a killed or a parking run has left on them."""
    own = {}
    before = before_run(record) or {}
    parked = _parked(record.study, before) if before else {}
    for node, values in now.items():
        left = nodes.before_killed(node, values)
        for name, value in left.items():
            of_killed = said_of_killed(node, name, values[name])
            _warn(f"{of_killed}; the previous value is {brief(str(value))}")
        still = {
            name: before[node][name]
            for name, value in parked.get(node, {}).items()
            if checks.holds(values[name], value)
        }
        own[node] = {**values, **still, **left}
    return own


def _parked(study: Study, before: NodeValues) -> NodeValues:
    """Return what a run leaves on nodes at its end, in place of what they had before."""
    keys = {study.nodes[item.node].node: item.node for item in study.parameters_of_nodes}
    safe = named_safe(study, {keys[node]: values for node, values in before.items()})
    return {node: safe.get(keys[node], {}) for node in before}


def _show(rows: list[Difference], title: str) -> None:
    table = Table(title=title, title_justify="left")
    for name in ("node", "parameter", "unit"):
        table.add_column(name)
    for name in ("now", "new"):
        table.add_column(name, justify="right")
    table.add_column("")
    for row in rows:
        cells = (row.node, row.parameter, row.unit, *_shown(row))
        table.add_row(*cells, "" if row.equal else "changes")
    print_table(plain_console(), table, heading=2)


def _shown(row: Difference) -> tuple[str, str]:
    """Format both values, with more digits if they would look equal but are not."""
    now, new = (_value(value) for value in (row.now, row.new))
    if now == new and not row.equal:
        now, new = repr(row.now), repr(row.new)
    return brief(now), brief(new)


def _value(value: object) -> str:
    if isinstance(value, bool):
        return shown(value)
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _warn(text: str) -> None:
    say_error(f"warning: {text}")


def _refuse(text: str, code: int) -> int:
    say_error(f"error: {text}")
    return code
