"""``apply``: set the result of a run on live nodes, or what they had before."""

import contextlib
import os
import select
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from bo_tuner.cli.common import Parser, guarded, split_ros_arguments
from bo_tuner.cli.exit_codes import EXIT_FAULT, EXIT_INFEASIBLE, EXIT_OK, EXIT_USAGE
from bo_tuner.deploy.apply import (
    ApplyError,
    NodeError,
    Nodes,
    certificate_problem,
    read_values,
    set_values,
)
from bo_tuner.deploy.bundle import (
    DEPLOY,
    ROLLBACK,
    Difference,
    differences,
    read_rollback,
    result_of,
    write_bundle,
)
from bo_tuner.deploy.live_parameters import LiveParameters
from bo_tuner.errors import BackendError
from bo_tuner.interruption import Interruption
from bo_tuner.metrics.collect import one_line
from bo_tuner.monitoring.display import plain_console, say
from bo_tuner.storage.parameter_file import NodeValues, node_values
from bo_tuner.storage.record import RunRecord, read_run
from bo_tuner.storage.run_folder import RunFolder

DESCRIPTION = """\
Set the result of a run on the nodes that run now: shows what would change, asks,
sets all or nothing, reads it back, and keeps what was there before in
RUN/deploy/rollback.yaml. Only a result with a passed certificate is set.
"""

EPILOG = """\
The nodes are looked for in the domain and with the discovery settings of the
environment (ROS_DOMAIN_ID), and in the namespace of --ros-args.

exit codes:
  0    the nodes run the values, as read back from them
  1    a node refused or did not answer; what had been set was set back
  2    something given is wrong: run, option, nodes, no terminal to ask in
  3    nothing was set: there is no passed certificate, the answer was no, or the
       nodes were changed while it was waited for
  130  interrupted by Ctrl-C before anything was set (143: by SIGTERM)

examples:
  apply runs/latest                              show the difference, ask, set
  apply runs/latest --yes                        without asking
  apply runs/latest --rollback                   back to what was there before
  apply runs/latest --without-certificate        on your own responsibility
  apply runs/latest --ros-args -r __ns:=/x_axis  nodes in a namespace
"""


def make_parser() -> Parser:
    """Make the parser of the command line."""
    parser = Parser("apply", DESCRIPTION, EPILOG)
    parser.add_argument("run", type=Path, metavar="RUN", help="folder of a run that has ended")
    parser.add_argument("--yes", action="store_true", help="set without asking")
    parser.add_argument(
        "--rollback", action="store_true", help=f"set what deploy/{ROLLBACK} of the run holds"
    )
    parser.add_argument(
        "--without-certificate",
        action="store_true",
        help="set a result that has no certificate, or failed it",
    )
    return parser


@guarded
def run(argv: Sequence[str], interruption: Interruption) -> int:
    """Run the command; returns its exit code, or exits after a wrong option.

    Parameters
    ----------
    argv
        The command line without the command; may hold ``--ros-args``.
    interruption
        Ends the command on a signal, until something is set.
    """
    own, ros_arguments = split_ros_arguments(argv)
    arguments = make_parser().parse_args(own)
    record = read_run(arguments.run)
    trial = result_of(record)
    if not arguments.rollback:
        problem = certificate_problem(record, trial)
        if problem and not arguments.without_certificate:
            return _refuse(f"{problem} (or --without-certificate)", EXIT_INFEASIBLE)
        if problem:
            _warn(f"{problem}; goes on without")
    # Nobody else writes the bundle meanwhile.
    folder = RunFolder(record.path)
    with contextlib.closing(folder):
        write_bundle(record)
        if arguments.rollback:
            new, title = read_rollback(record), f"back to deploy/{ROLLBACK}"
        else:
            new = node_values(record.study, trial.parameters)
            title = f"result of trial {trial.number}"
        os.environ.setdefault("ROS_LOG_DIR", str(folder.log))
        with LiveParameters(list(new), ros_arguments, interruption.check) as nodes:
            try:
                now = read_values(nodes, new)
                rows = differences(record.study, now, new)
                _show(rows, f"{record.study.name}: {title}")
                if all(row.equal for row in rows):
                    say("these values are in force already; nothing to set")
                    return EXIT_OK
                if not arguments.yes:
                    if not sys.stdin.isatty():
                        return _refuse("no terminal to ask in; --yes does not ask", EXIT_USAGE)
                    if not _confirmed(f"set these on {', '.join(new)}? [y/N] ", interruption):
                        say("nothing was set")
                        return EXIT_INFEASIBLE
                    if read_values(nodes, new) != now:
                        return _refuse("the nodes run something else by now", EXIT_INFEASIBLE)
            except NodeError as error:
                raise BackendError(str(error)) from error
            return _set(record, nodes, now, new, interruption, is_rollback=arguments.rollback)


def _set(
    record: RunRecord,
    nodes: Nodes,
    now: NodeValues,
    new: NodeValues,
    interruption: Interruption,
    *,
    is_rollback: bool,
) -> int:
    # The folder itself: `latest` will be another run one day.
    folder = record.path.resolve()
    rollback = folder / DEPLOY / ROLLBACK
    if not is_rollback:
        write_bundle(record, rollback=now)
    interruption.check()
    # From here on it is all or nothing.
    interruption.ignore()
    try:
        set_values(nodes, now, new)
    except ApplyError as error:
        kept = "" if is_rollback else f"; {rollback} has what was there before"
        return _refuse(f"{error}{kept}", EXIT_FAULT)
    say(f"set and read back on {', '.join(new)}")
    if not is_rollback:
        say(f"what was there before: {rollback}; back by: apply {folder} --rollback")
    return EXIT_OK


def _show(rows: list[Difference], title: str) -> None:
    table = Table(title=title, title_justify="left")
    for name in ("node", "parameter", "unit"):
        table.add_column(name, overflow="fold")
    for name in ("now", "new"):
        table.add_column(name, justify="right", overflow="fold")
    table.add_column("", no_wrap=True)
    for row in rows:
        cells = (row.node, row.parameter, row.unit, *_shown(row))
        table.add_row(*cells, "" if row.equal else "changes")
    plain_console().print(table)


def _shown(row: Difference) -> tuple[str, str]:
    """Show both values as briefly as tells them apart."""
    now, new = (f"{v:.6g}" if isinstance(v, float) else str(v) for v in (row.now, row.new))
    if now == new and not row.equal:
        now, new = repr(row.now), repr(row.new)
    return one_line(now), one_line(new)


def _confirmed(question: str, interruption: Interruption) -> bool:
    """Ask; only yes is a yes."""
    sys.stdout.write(question)
    sys.stdout.flush()
    # Reading would go on after a signal, so it waits until there is something to read.
    while not select.select([sys.stdin], [], [], 0.1)[0]:
        interruption.check()
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _warn(text: str) -> None:
    sys.stderr.write(f"warning: {' '.join(text.split())}\n")


def _refuse(text: str, code: int) -> int:
    sys.stderr.write(f"error: {' '.join(text.split())}\n")
    return code
