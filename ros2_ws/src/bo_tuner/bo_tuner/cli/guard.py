"""``guard``: a guard that is started by hand, near the machine."""

import contextlib
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from bo_tuner.backends.ros.graph import describe_nodes
from bo_tuner.backends.ros.guard.guard import Guard, TopicBeats, end_on_signals
from bo_tuner.backends.ros.guard.plan import Plan, patience, patience_of
from bo_tuner.cli.common import Parser, guarded, split_ros_arguments
from bo_tuner.cli.exit_codes import EXIT_OK
from bo_tuner.interruption import Interruption
from bo_tuner.monitoring.display import say
from bo_tuner.study.guarding import Guarding
from bo_tuner.study.study_file import load_study

DESCRIPTION = """\
Watch over the nodes of a study, best on the machine's own computer: when a
tuner that is at work on them dies, hangs, loses the network or misses the
condition abort_when, publish the stop messages at the head of run.after, set
the safe parameters (park) and read them back. tune, validate, replay and
check with --attach find the guard by themselves; without one they start
their own, on their own computer.
"""

EPILOG = """\
exit codes:
  0    ended by SIGTERM or Ctrl-C; nodes in a tuner's hands were left safe first
  1    output could not be written (141: the output pipe was closed)
  2    bad input: study or option, nodes that another guard has, or a stop
       message that nobody hears
  130  Ctrl-C while it asked nodes for what the study leaves open (143: SIGTERM)

examples:
  guard --study servo.yaml                            until SIGTERM ends it
  guard --study servo.yaml --timeout 1.0              with more patience
  guard --study servo.yaml --ros-args -r __ns:=/cell  nodes in a namespace
"""


def make_parser() -> Parser:
    """Return the parser of the command line."""
    parser = Parser("guard", DESCRIPTION, EPILOG)
    parser.add_argument("--study", required=True, metavar="FILE", help="study of the nodes")
    parser.add_argument(
        "--timeout",
        type=float,
        metavar="S",
        help="act after this time without a heartbeat (default: the study's guard.timeout)",
    )
    parser.add_argument(
        "--record", type=Path, metavar="FILE", help="add a line of JSON for each act to this file"
    )
    return parser


@guarded
def run(argv: Sequence[str], interruption: Interruption) -> int:
    """Run the command: a `common.Run`."""
    own, ros_arguments = split_ros_arguments(argv)
    parser = make_parser()
    arguments = parser.parse_args(own)
    describe = partial(describe_nodes, ros_arguments=ros_arguments, interrupted=interruption.check)
    study = load_study(arguments.study, describe)
    waits = patience(study)
    if arguments.timeout is not None:
        waits = patience_of(Guarding(timeout=arguments.timeout))
    guard = Guard(
        Plan.of(study),
        ros_arguments,
        TopicBeats(),
        patience=waits,
        attached=True,
        record=arguments.record,
        say=say,
    )
    with contextlib.closing(guard):
        end_on_signals(guard, by_hand=True)
        guard.open(wait=True)
        say(f"guards {', '.join(guard.nodes)} for studies like {study.name}")
        guard.serve()
    return EXIT_OK
