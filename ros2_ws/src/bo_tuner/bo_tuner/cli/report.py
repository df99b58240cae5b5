"""``report``: write the report of a run, and its figures as files."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from bo_tuner.cli.common import Parser, guarded, read_result, trial_of, whole_number
from bo_tuner.cli.exit_codes import EXIT_OK, EXIT_USAGE
from bo_tuner.cli.streams import say_error
from bo_tuner.cli.web_options import add_control_argument, add_host_argument, port, tell_address
from bo_tuner.errors import RunRecordError
from bo_tuner.interruption import Interruption
from bo_tuner.monitoring.display import say
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.comparison import comparison, names
from bo_tuner.report.page import (
    FORMATS,
    chapters,
    figures,
    report_figures,
    write_comparison,
    write_figure,
    write_page,
    write_trial,
)
from bo_tuner.report.trial_page import trial_sections
from bo_tuner.storage.run_folder import JOURNAL, REPORT
from bo_tuner.storage.trust import trust
from bo_tuner.web.address import listen
from bo_tuner.web.run_pages import serve_runs
from bo_tuner.web.started import Started

DESCRIPTION = """\
Explain a run in one HTML file: the result first, then the evidence for it, the
signals, what the parameters do, the trials, and details.
The file needs no network; the run may still be in progress. Of several runs,
compare verdicts, parameters, numbers, convergence and trajectories. With
--serve, look at all runs of a folder in a browser: list, filter, compare,
trials, notes, files.
"""

EPILOG = """\
exit codes:
  0    the report is written
  1    standard output cannot be written
  2    bad input: run folder, option, or a file that cannot be written
  130  interrupted by Ctrl-C (143: by SIGTERM, 129: the terminal was closed,
       141: the output pipe was closed); --serve ends like that

examples:
  report latest                           the latest run in runs/
  report runs/benchmark-20260801-101500   into its folder, as report.html
  report latest --output answer.html      elsewhere
  report runs/a runs/b runs/c             compared, as comparison.html
  report latest --trial 12                one trial, with its signals
  report latest --figures plots --format png,svg
  report --serve runs                     all runs in this folder, in a browser
"""

COMPARISON = "comparison.html"


def make_parser() -> Parser:
    """Return the parser of the command line."""
    parser = Parser("report", DESCRIPTION, EPILOG)
    parser.add_run_argument("run folder, or several to compare", several=True)
    parser.add_argument(
        "--output",
        type=Path,
        metavar="FILE",
        help=f"HTML file (default: RUN/{REPORT}; of several runs: {COMPARISON})",
    )
    parser.add_argument(
        "--trial",
        type=whole_number,
        metavar="N",
        help="the page of this trial: its parameters, its test runs, and the signals of the "
        "worst one (default file: RUN/trial_NNNN.html)",
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
    group = parser.add_argument_group("in a browser")
    group.add_argument(
        "--serve",
        type=Path,
        metavar="FOLDER",
        help="serve all runs in this folder until Ctrl-C, read-only, on this machine only, at an "
        "address with a token that is printed",
    )
    group.add_argument(
        "--web-port",
        type=port,
        metavar="PORT",
        help="with --serve: take this port (default: any that is free)",
    )
    starts = "start commands that it shows (validate, try, replay), one at a time, and end them"
    add_control_argument(group, "--serve", starts)
    add_host_argument(group, "--serve")
    return parser


@guarded
def run(argv: Sequence[str], interruption: Interruption) -> int:
    """Run the command: a `common.Run`."""
    parser = make_parser()
    arguments = parser.parse_args(argv)
    if arguments.serve is not None:
        _serve(arguments, parser, interruption)
    _refuse_without_serve(arguments, parser)
    if arguments.trial is not None and len(arguments.run) > 1:
        parser.error("--trial: expected one run")
    analyses = _read(arguments.run)
    if not analyses:
        return EXIT_USAGE
    if arguments.trust:
        for analysis in analyses:
            trust(analysis.study)
    if arguments.trial is not None:
        (analysis,) = analyses
        number = trial_of(analysis.record, arguments.trial).number
        (trial,) = [trial for trial in analysis.trials if trial.number == number]
        parts = trial_sections(analysis, trial)
        drawn = figures(parts)
        interruption.check()
        of_trial = analysis.record.path / f"trial_{number:04d}.html"
        path = write_trial(analysis, trial, parts, arguments.output or of_trial)
    elif len(analyses) == 1:
        (analysis,) = analyses
        contents = chapters(analysis)
        drawn = report_figures(analysis, contents)
        interruption.check()
        path = write_page(analysis, contents, arguments.output or analysis.record.path / REPORT)
    else:
        parts = comparison(dict(zip(names(analyses), analyses, strict=True)))
        drawn = figures(parts)
        interruption.check()
        title = f"{len(analyses)} runs side by side"
        path = write_comparison(title, parts, arguments.output or Path(COMPARISON))
    say(f"report: {path}")
    if arguments.figures is not None:
        for figure in drawn:
            for written in write_figure(figure, arguments.figures, arguments.format):
                say(f"figure: {written}")
            interruption.check()
    return EXIT_OK


def _serve(arguments: argparse.Namespace, parser: Parser, interruption: Interruption) -> NoReturn:
    """Serve the runs in a folder until a signal ends it."""
    for name in ("run", "output", "trial", "figures", "trust"):
        if getattr(arguments, name) not in (None, False, []):
            given = "a run" if name == "run" else f"--{name}"
            parser.error(f"--serve shows all runs of a folder; leave {given} out")
    folder: Path = arguments.serve
    if not folder.is_dir() or (folder / JOURNAL).exists():
        found = "a run folder" if folder.is_dir() else "no folder"
        raise RunRecordError(f"--serve {folder}: expected a folder of runs, found {found}")
    address = listen(arguments.web_port or 0, arguments.web_host, "--web-port")
    tell_address(address, f"runs in {folder}", say)
    started = Started(say) if arguments.web_control else None
    serve_runs(address, folder, interruption, started)


def _refuse_without_serve(arguments: argparse.Namespace, parser: Parser) -> None:
    """Refuse what is of use with --serve alone, and no run without it."""
    for name in ("web_port", "web_host", "web_control"):
        if getattr(arguments, name) not in (None, False):
            parser.error(f"--{name.replace('_', '-')} needs --serve")
    if not arguments.run:
        parser.error("expected a run folder, or --serve FOLDER")


def _read(runs: Sequence[Path]) -> list[Analysis]:
    """Read all runs; none if one cannot be read, with a line on each of these."""
    analyses: dict[Path, Analysis] = {}
    readable = True
    for run in runs:
        try:
            analysis = Analysis(read_result(run))
            path = analysis.record.path.resolve()
            if path in analyses:
                raise RunRecordError(f"{run}: named twice; expected different runs")
            analyses[path] = analysis
        except RunRecordError as error:
            say_error(f"error: {error}")
            readable = False
    return list(analyses.values()) if readable else []


def _formats(text: str) -> tuple[str, ...]:
    chosen = tuple(part.strip() for part in text.split(","))
    if not set(chosen) <= set(FORMATS):
        raise argparse.ArgumentTypeError(f"{text}: expected one or more of {', '.join(FORMATS)}")
    return chosen
