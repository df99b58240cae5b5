"""``recompute``: metrics of a run from its bags, also those of another study."""

from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from bo_tuner.cli.common import Parser, allow_programs, guarded, run_folder
from bo_tuner.cli.exit_codes import EXIT_INFEASIBLE, EXIT_OK
from bo_tuner.interruption import Interruption
from bo_tuner.monitoring.display import plain_console, say
from bo_tuner.replay.recompute import Recomputed, differing, recompute
from bo_tuner.storage.atomic import write_atomically
from bo_tuner.storage.csv_tables import csv_text
from bo_tuner.storage.record import read_run
from bo_tuner.study.study_file import load_study
from bo_tuner.terminal import print_table
from bo_tuner.text import counted

DESCRIPTION = """\
Compute the metrics of every recorded test run again from the signals in its
bag, and compare those of the run's own study with the record: they are equal in
all digits. With --study, compute the metrics that another study defines of the
same signals. Nothing is run, and no node is needed.
"""

EPILOG = """\
exit codes:
  0    every metric that is defined as in the run is as recorded
  1    standard output cannot be written
  2    bad input: run, bag or study, or a file that cannot be written
  3    a metric differs from the record; the table shows where
  130  interrupted by Ctrl-C (143: by SIGTERM, 129: the terminal was closed,
       141: the output pipe was closed)

examples:
  recompute latest                              is the record right?
  recompute latest --study other_metrics.yaml   what other metrics would say
  recompute latest --csv metrics.csv            for a spreadsheet
"""


def make_parser() -> Parser:
    """Return the parser of the command line."""
    parser = Parser("recompute", DESCRIPTION, EPILOG)
    parser.add_run_argument()
    parser.add_argument(
        "--study",
        metavar="FILE",
        help="study with the signals and metrics to compute (default: the run's)",
    )
    parser.add_argument(
        "--trust",
        action="store_true",
        help="import the functions that the run's study names, now and later; read the study first "
        "if the run is not yours",
    )
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write the table to this file")
    return parser


@guarded
def run(argv: Sequence[str], interruption: Interruption) -> int:
    """Run the command: a `common.Run`."""
    arguments = make_parser().parse_args(argv)
    record = read_run(run_folder(arguments.run))
    if arguments.study is None:
        # A metric may be a function of the study.
        allow_programs(record, trusted=arguments.trust, attach=True)
        study = record.study
    else:
        study = load_study(arguments.study)
    table = Table()
    names = [name for name in study.metrics if name not in study.relative_metrics]
    header = ("bag", "trial", "evaluation", "stage", *names, "")
    for column in header:
        table.add_column(column)
    rows: list[tuple[object, ...]] = []
    wrong = 0
    for recomputed in recompute(record, study, interruption.check):
        interruption.check()
        differs = differing(record, study, recomputed)
        wrong += bool(differs)
        rows.append(_row(names, recomputed, differs))
        table.add_row(*[f"{v:.6g}" if isinstance(v, float) else str(v) for v in rows[-1]])
    print_table(plain_console(), table, heading=4, remarks=True)
    if arguments.csv is not None:
        text = csv_text([(*header[:-1], "note"), *rows])
        say(f"table: {write_atomically(arguments.csv, text)}")
    if study.relative_metrics:
        say(
            f"left out: {', '.join(study.relative_metrics)}, relative to the default, whose runs "
            "beside these are in no bag"
        )
    say(f"{counted(len(rows), 'test run')}; {wrong} differ from the record")
    return EXIT_INFEASIBLE if wrong else EXIT_OK


def _row(
    names: Sequence[str], recomputed: Recomputed, differs: Sequence[str]
) -> tuple[object, ...]:
    run, outcome = recomputed.run, recomputed.outcome
    notes = [] if outcome.complete else [outcome.reason]
    if differs:
        recorded = (f"{name} {run.evaluation['metrics'][name]!r}" for name in differs)
        notes.append(f"recorded: {', '.join(recorded)}")
    metrics = (outcome.metrics.get(name, "") for name in names)
    evaluation = run.evaluation
    return run.bag, run.trial, evaluation["index"], evaluation["stage"], *metrics, "; ".join(notes)
