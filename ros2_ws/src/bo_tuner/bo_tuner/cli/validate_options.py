"""The options of ``validate``."""

import argparse
from pathlib import Path

from bo_tuner.cli.common import Parser, fraction, whole_number
from bo_tuner.cli.drift import FALSE_ALARMS, RUNS
from bo_tuner.cli.given_values import add_given_arguments
from bo_tuner.cli.notify import add_notify_argument
from bo_tuner.cli.time_limit import TimeLimit, time_limit
from bo_tuner.cli.workers import add_workers_arguments
from bo_tuner.storage.run_folder import BEST
from bo_tuner.study.parts import BACKENDS

DESCRIPTION = """\
Certify the result of a run, or values that somebody else tuned: make fresh
test runs in random contexts, search for the worst context again, and report
PASS or FAIL for the constraints of the study. It ends as soon as the
verdict is clear, and continues where an interrupted one stopped.
"""

EPILOG = """\
PASS requires all of these; a constraint not proven counts as violated:
  chance constraint   the upper bound of the probability that a test run is over
                      it is at most 1 - probability
  worst-case          in each of the worst contexts of the search, the upper
  constraint          bound of the mean over noise is within the limit, or of
                      the probability of a violation at most 1 - probability
  failed test runs    none
Contexts in which this parameter set failed before are run again, and its
earlier runs count against a PASS, never for it.
The bounds hold after each test run, and over all certificates of the run: the
first has four fifths of the error probability, and each later one less, and
fresh test runs; --with-default divides that between the two parameter sets.

--drives runs a parameter set, and the default, once on each of some bags that
the search has not used. PASS requires that as large a share of drives as the
limits ask for is within all of them, with the confidence of the study, by the
count of those that are; a failed run is not. It writes RUN/drives/0001.json.

A certificate is written to RUN/certificates/0001.json, or the next number, and
its test runs as CSV beside it; earlier ones stay. For `apply` it needs the test
runs and the confidence that the study requires, and no later FAIL of the same
parameters.

--against tests whether the machine has drifted since a certificate: with a few
fresh runs of its parameter set, metric by metric, after each run. It writes
RUN/drift/0001.json, or the next number, and no certificate.

exit codes:
  0    PASS
  1    no verdict (nodes lost or disturbed three times in a row, their guard
       ended, disk full, the --time is over); an existing certificate is kept,
       and the next call continues from here; or an attached node was not
       restored
  2    bad input: run, option or nodes
  3    FAIL; --against: a metric has drifted
  130  interrupted by Ctrl-C (143: by SIGTERM, 129: the terminal was closed,
       141: the output pipe was closed); as 1

examples:
  validate latest                          as many runs as the study requires
  validate latest --time 10min             what is shown by then, if no verdict
  validate runs/latest --runs 1000 --confidence 0.99
  validate runs/latest --backend inprocess
  validate runs/latest --workers 4         four test runs at once
  validate runs/latest --attach            on nodes that are running
  validate runs/latest --trial 12          another parameter set of the run
  validate runs/latest --until-pass 3      up to two more if the result fails
  validate runs/latest --with-default      the default, too, in the same ones
  validate --parameters my_params.yaml --study my_study.yaml    without a run
  validate latest --junit report.xml       for a CI server
  validate --against runs/latest/certificates/0001.json    drifted since?
  validate latest --drives new_drives/*    what to expect of the next drive
  validate runs/latest && echo fit for use
"""


OF_DRIFT: tuple[str, ...] = ("metrics", "false_alarms")
OF_CERTIFICATE: tuple[str, ...] = (
    "run", "trial", "until_pass", "with_default", "parameters", "study", "output",
    "confidence", "time", "junit", "workers", "window",
)  # fmt: skip
"""Names of the arguments that only one of the two kinds of the command takes."""


def make_parser() -> Parser:
    """Return the parser of the command line."""
    parser = Parser("validate", DESCRIPTION, EPILOG)
    parser.add_run_argument(optional=True)
    sets = parser.add_argument_group("what to certify")
    sets.add_argument(
        "--trial",
        type=whole_number,
        metavar="N",
        help=f"the parameter set of this trial (default: that of the run's {BEST})",
    )
    sets.add_argument(
        "--until-pass",
        type=whole_number,
        default=1,
        metavar="K",
        help="after a FAIL, continue with the next-ranked parameter sets that are believed "
        "feasible and have no certificate yet, up to K in all",
    )
    sets.add_argument(
        "--with-default", action="store_true", help="certify the default as well, to compare"
    )
    add_given_arguments(sets)
    evidence = parser.add_argument_group("evidence")
    evidence.add_argument(
        "--runs",
        type=whole_number,
        metavar="N",
        help="fresh test runs at most, at random and again in each of the worst contexts "
        f"(default: as the study requires; with --against {RUNS})",
    )
    evidence.add_argument(
        "--confidence",
        type=fraction,
        metavar="P",
        help="confidence over all certificates of the run, between 0 and 1 (default: as the study "
        "requires)",
    )
    evidence.add_argument(
        "--time",
        type=time_limit,
        default=TimeLimit(),
        metavar="TIME",
        help="begin no more runs after this time, such as 90s, 10min or 2h, and say what is shown "
        "by then; the next call goes on",
    )
    drift = parser.add_argument_group("drift since a certificate, instead")
    drift.add_argument(
        "--against",
        type=Path,
        metavar="CERTIFICATE",
        help="run its parameter set again, and compare the metrics with its runs; RUN is left out",
    )
    drift.add_argument(
        "--metrics",
        metavar="NAME,...",
        help="metrics to compare (default: all but measured times and what is computed from "
        "others)",
    )
    drift.add_argument(
        "--false-alarms",
        type=fraction,
        metavar="P",
        help="probability of a drift in any metric where there is none, at most (default: "
        f"{FALSE_ALARMS})",
    )
    parser.add_argument_group("drives, instead").add_argument(
        "--drives",
        nargs="+",
        default=[],
        metavar="BAG",
        help="for a study that plays bags: run the parameter set on drives that the search has "
        "not used, and say what to expect of the next one",
    )
    parser.add_argument_group("files").add_argument(
        "--junit",
        type=Path,
        metavar="FILE",
        help="also write the verdict as JUnit XML, with a test case for each limit",
    )
    parser.add_backend_arguments(f"as in the run, else {BACKENDS[0]}")
    add_workers_arguments(parser, "as in the run")
    add_notify_argument(parser.add_argument_group("output"))
    return parser


def check_kind(arguments: argparse.Namespace, parser: Parser) -> None:
    """Refuse options of a certificate in a comparison with one, and the other way round."""
    names, why = (
        (OF_DRIFT, "needs --against")
        if arguments.against is None
        else (OF_CERTIFICATE, "is not for --against")
    )
    for name in names:
        if getattr(arguments, name) != parser.get_default(name):
            option = "RUN" if name == "run" else f"--{name.replace('_', '-')}"
            parser.error(f"{option} {why}")
