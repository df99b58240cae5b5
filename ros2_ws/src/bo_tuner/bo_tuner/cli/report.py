"""``report``: write the report of a run, and its figures as files."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from bo_tuner.cli.common import Parser, guarded, read_result
from bo_tuner.cli.exit_codes import EXIT_OK
from bo_tuner.interruption import Interruption
from bo_tuner.monitoring.display import say
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.page import NAME, figures, sections, write_page
from bo_tuner.storage.trust import trust

DESCRIPTION = """\
Explain a run in one HTML file: the answer first, then convergence, contexts,
trajectories, surrogates, sensitivity to the parameters, times and failures.
The file needs no network; the run may still be in progress.
"""

EPILOG = """\
exit codes:
  0    the report is written
  1    the output cannot be written
  2    bad input: run folder, option, or a file that cannot be written
  130  interrupted by Ctrl-C (143: by SIGTERM, 129: the terminal was closed,
       141: nobody reads the output any more)

examples:
  report latest                           the latest run in runs/
  report runs/benchmark-20260801-101500   into its folder, as report.html
  report latest --output answer.html      elsewhere
  report latest --figures plots --format png,svg
"""

FORMATS = ("png", "svg")


def make_parser() -> Parser:
    """Return the parser of the command line."""
    parser = Parser("report", DESCRIPTION, EPILOG)
    parser.add_run_argument()
    parser.add_argument(
        "--output", type=Path, metavar="FILE", help=f"HTML file (default: RUN/{NAME})"
    )
    parser.add_argument(
        "--figures", type=Path, metavar="DIR", help="also write the figures to this folder"
    )
    parser.add_argument(
        "--format",
        type=_formats,
        default=FORMATS,
        metavar=",".join(FORMATS),
        help="formats of the figures (default: all)",
    )
    parser.add_trust_argument()
    return parser


@guarded
def run(argv: Sequence[str], interruption: Interruption) -> int:
    """Run the command and return its exit code; exits on a wrong option.

    Parameters
    ----------
    argv
        The command line without the command.
    interruption
        Ends the command on a signal.
    """
    arguments = make_parser().parse_args(argv)
    record = read_result(arguments.run)
    if arguments.trust:
        trust(record.study)
    analysis = Analysis(record)
    parts = sections(analysis)
    interruption.check()
    path = write_page(analysis, parts, arguments.output or analysis.record.path / NAME)
    say(f"report: {path}")
    if arguments.figures is not None:
        # Matplotlib takes a second to load.
        from bo_tuner.figures.matplotlib_renderer import write_figure

        for figure in figures(parts):
            for written in write_figure(figure, arguments.figures, arguments.format):
                say(f"figure: {written}")
            interruption.check()
    return EXIT_OK


def _formats(text: str) -> tuple[str, ...]:
    chosen = tuple(part.strip() for part in text.split(","))
    if not set(chosen) <= set(FORMATS):
        raise argparse.ArgumentTypeError(f"{text}: expected one or more of {', '.join(FORMATS)}")
    return chosen
