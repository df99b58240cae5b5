"""``replay``: repeat a recorded evaluation, compare its metrics, record default and tuned."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from bo_tuner.backends.factory import make_backend
from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.cli.common import (
    Parser,
    allow_programs,
    attached,
    ended,
    guarded,
    in_namespace_of,
    opened,
    read_result,
    recorded_backend,
    split_ros_arguments,
    whole_number,
)
from bo_tuner.cli.exit_codes import EXIT_INFEASIBLE, EXIT_OK
from bo_tuner.interruption import Interruption
from bo_tuner.monitoring.display import plain_console, say
from bo_tuner.recording.inbox import Batch, Inbox
from bo_tuner.recording.topic_listener import listen_to
from bo_tuner.replay.replay import (
    BEST,
    WORST,
    Comparison,
    Replay,
    changed_provenance,
    find_evaluation,
    find_trial,
    replay,
)
from bo_tuner.replay.side_by_side import LATEST_QUIET, QUIET, write_side_by_side
from bo_tuner.storage.atomic import writing
from bo_tuner.storage.provenance import provenance
from bo_tuner.storage.record import RunRecord
from bo_tuner.storage.run_files import LOGS
from bo_tuner.study.parts import IN_PROCESS
from bo_tuner.terminal import print_table
from bo_tuner.text import values
from bo_tuner.trials import DEFAULT, TUNED, Evaluation
from bo_tuner.tuning.driver import Driver

DESCRIPTION = """\
Repeat a recorded test run with its parameters, context and seed, and compare
its metrics with the record, bit for bit where they can be the same. On ROS the
messages of this test run, and of the default parameters in the same context
with the same noise, are recorded side by side in one bag, as /tuned/... and
/default/...
"""

EPILOG = """\
A metric of signals, or one that the study marks as not reproducible since it
depends on measured time, is shown, but judged only if record and replay are
both in process.

exit codes:
  0    the result is as recorded, in all that is judged
  1    the nodes' guard ended, an attached node was not restored, or standard
       output cannot be written
  2    bad input: run, trial, test run, option or nodes, or a folder that
       cannot be written
  3    the result differs; the table shows where
  130  interrupted by Ctrl-C (143: by SIGTERM, 129: the terminal was closed,
       141: the output pipe was closed)

examples:
  replay runs/latest                           the result's worst test run
  replay runs/latest --trial worst             the worst trial's
  replay runs/latest --trial 7 --evaluation 3  any test run
  replay runs/latest --backend inprocess       without nodes, without a bag
"""


def make_parser() -> Parser:
    """Return the parser of the command line."""
    parser = Parser("replay", DESCRIPTION, EPILOG)
    parser.add_run_argument()
    parser.add_argument(
        "--trial",
        default=BEST,
        metavar=f"N|{BEST}|{WORST}",
        help=f"number of the trial; {BEST} is the run's result, {WORST} the trial with the largest "
        f"worst case (default: {BEST})",
    )
    parser.add_argument(
        "--evaluation",
        type=whole_number,
        metavar="K",
        help="number of the test run within the trial (default: the worst)",
    )
    parser.add_backend_arguments("as in the run")
    parser.add_argument(
        "--output", type=Path, metavar="DIR", help="folder for the bag (default: RUN/replay)"
    )
    return parser


@guarded
def run(argv: Sequence[str], interruption: Interruption) -> int:
    """Run the command: a `common.Run`."""
    own, ros_arguments = split_ros_arguments(argv)
    parser = make_parser()
    arguments = parser.parse_args(own)
    record = read_result(arguments.run)
    name = arguments.backend or recorded_backend(record)
    attach = attached(arguments, parser, name, record)
    if name == IN_PROCESS and arguments.output is not None:
        parser.error("--output needs --backend ros: without nodes there are no messages")
    recorded = find_evaluation(record, find_trial(record, arguments.trial), arguments.evaluation)
    allow_programs(record, trusted=arguments.trust, attach=attach)
    console = plain_console(stderr=True)
    console.print(_description(recorded, name), soft_wrap=True)
    output = arguments.output or record.path / "replay"
    log = output / LOGS
    backend = make_backend(
        name,
        record.study,
        log,
        attach=attach,
        run_log=record.path / LOGS,
        ros_arguments=in_namespace_of(record, ros_arguments),
        interrupted=interruption.check,
        earlier=record.evaluations,
    )
    if isinstance(backend, RosBackend):
        with writing(log):
            log.mkdir(parents=True, exist_ok=True)
        with opened(backend, interruption) as left:
            result, default, sides, warnings = _run_both(record, recorded, backend)
        _show(record, result, name)
        for warning in warnings:
            console.print(warning, soft_wrap=True)
        path = output / f"trial_{recorded.trial:04d}_evaluation_{recorded.index:02d}"
        lost = sum(batch.lost for batch in sides.values())
        notes = _notes(record, recorded, result.replayed, default, lost)
        messages = {side: batch.messages for side, batch in sides.items()}
        if write_side_by_side(path, messages, notes):
            say(f"bag of {' and '.join(sides)}: {path}")
        else:
            console.print("no bag: no message was received", soft_wrap=True)
    else:
        with opened(backend, interruption) as left:
            result = replay(record, recorded, backend)
        _show(record, result, name)
        console.print("no bag: a test run in process has no messages", soft_wrap=True)
    return ended(left, EXIT_OK if result.confirmed else EXIT_INFEASIBLE)


def _description(evaluation: Evaluation, backend: str) -> str:
    return (
        f"trial {evaluation.trial}, test run {evaluation.index} ({evaluation.stage}; "
        f"context {values(evaluation.context) or 'none'}; seed {evaluation.seed}) on {backend}"
    )


def _run_both(
    record: RunRecord, recorded: Evaluation, ros: RosBackend
) -> tuple[Replay, Evaluation, dict[str, Batch], list[str]]:
    """Run the evaluation, then with the default parameters."""
    inbox = Inbox(QUIET, LATEST_QUIET)
    listener = listen_to(ros, inbox)
    try:
        inbox.collect(listener.take)
        # The bag is of the two evaluations, and of no run beside or ahead of one.
        ros.after_extra_run = lambda: inbox.collect(listener.take)
        result = replay(record, recorded, ros)
        sides = {TUNED: inbox.collect(listener.take)}
        # Nodes that were lost have been restarted, and may have other topics.
        listener.refresh()
        defaults = record.study.search_space().defaults
        default = Driver(ros).evaluate(dataclasses.replace(recorded, parameters=defaults))
        sides = {DEFAULT: inbox.collect(listener.take)} | sides
        return result, default, sides, inbox.warnings
    finally:
        listener.close()


def _notes(
    record: RunRecord,
    recorded: Evaluation,
    tuned: Evaluation,
    default: Evaluation,
    lost: int,
) -> dict[str, object]:
    """Say what is in the bag."""
    notes: dict[str, object] = {
        "study": record.study.name,
        "trial": str(recorded.trial),
        "evaluation": str(recorded.index),
        "stage": str(recorded.stage),
        "context": dict(recorded.context),
        "seed": str(recorded.seed),
        "lost_messages": str(lost),
    }
    for side, ran in ((DEFAULT, default), (TUNED, tuned)):
        notes[side] = {
            "parameters": dict(ran.parameters),
            "state": str(ran.outcome.state),
            "reason": ran.outcome.reason,
            "metrics": dict(ran.outcome.metrics),
        }
    return notes


def _show(record: RunRecord, result: Replay, backend: str) -> None:
    table = Table(title=f"{record.study.name}: recorded against replayed", title_justify="left")
    for name in ("metric", "unit"):
        table.add_column(name)
    for name in ("recorded", "replayed", "difference"):
        table.add_column(name, justify="right")
    table.add_column("")
    for row in result.metrics:
        values = (row.recorded, row.replayed)
        table.add_row(
            row.metric.title,
            row.metric.unit,
            *("-" if value is None else f"{value:.6g}" for value in values),
            "-" if row.difference is None else f"{row.difference:.3g}",
            _word(row),
        )
    print_table(plain_console(), table)
    bounded = result.recorded.outcome.notes.at_least
    measured = [
        row.metric.title
        for row in result.metrics
        if not row.judged and (not bounded or row.at_least)
    ]
    if measured:
        say(f"measured, so different in each run, and not judged: {', '.join(measured)}")
    if record.study.seed_parameter is None:
        say("the study has no parameter for the seed: noise, if there is any, was not the same")
    before, after = result.recorded.outcome, result.replayed.outcome
    if before.was_cut_short:
        say(f"recorded: {before.reason}; the replay is whole, and its metrics may be larger")
    elif result.same_end:
        how = f"{after.state}, as recorded"
        say(f"{how}: {after.reason}" if after.reason else how)
    else:
        say(f"recorded: {before.state}{f': {before.reason}' if before.reason else ''}")
        say(f"replayed: {after.state}{f': {after.reason}' if after.reason else ''}")
    say(result.verdict)
    now = provenance(record.study, backend, record.algorithm)
    changed = changed_provenance(record, now)
    if changed and not result.confirmed:
        say(f"changed since the record: {'; '.join(changed)}")


def _word(row: Comparison) -> str:
    if not row.judged:
        return "not judged"
    if not row.agrees:
        return "DIFFERENT"
    return "at least as large" if row.at_least else "equal"
