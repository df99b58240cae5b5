"""``benchmark``: a campaign of many runs, judged by the truth, as one results page."""

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bo_tuner.cli.common import Parser, guarded
from bo_tuner.cli.exit_codes import EXIT_FAULT, EXIT_OK
from bo_tuner.errors import RunError
from bo_tuner.interruption import Interrupted, Interruption
from bo_tuner.report.page import write_figure
from bo_tuner.storage.atomic import write_atomically, writing
from tuning_benchmark.campaign import provenance
from tuning_benchmark.campaign.execution import conduct, unfinished
from tuning_benchmark.campaign.records import Records
from tuning_benchmark.campaign.tasks import Task, tasks_of
from tuning_benchmark.experiments import plugins
from tuning_benchmark.experiments.experiment import Experiment
from tuning_benchmark.experiments.experiment_file import load_experiment, shipped_experiments
from tuning_benchmark.pages import fronts, page
from tuning_benchmark.pages.partial import on_record
from tuning_benchmark.pages.published import publish

DESCRIPTION = """\
Run the algorithms of the paper, or other optimizers, many times on a study,
judge each answer by the truth, and write a page of tables and figures. Each
finished task is recorded at once: an interrupted campaign resumes from there.
`make benchmark` in the repository installs BoTorch, Optuna, SMAC3 and CMA-ES
first and compares them, too.
"""

EPILOG = """\
exit codes:
  0    the page is written
  1    the campaign was aborted, or a task failed (listed on the page)
  2    bad input: experiment, option, cluster, or records of another version of
       the code
  130  interrupted by Ctrl-C (143: by SIGTERM); finished tasks are on record

examples:
  benchmark                              the paper's tables and figures
  benchmark --experiment small --jobs 2  all algorithms, in half a minute
  benchmark --experiment ./mine.yaml --output mine
  benchmark --cluster dask://10.0.0.5:8786
"""

PAGE = "results.md"


def make_parser() -> Parser:
    """Make the parser of the command line."""
    parser = Parser("benchmark", DESCRIPTION, EPILOG)
    parser.add_argument(
        "--experiment",
        action="append",
        metavar="NAME|FILE",
        help=f"shipped experiment ({', '.join(shipped_experiments())}) or path of a file; several "
        "make one page (default: paper)",
    )
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("benchmark_results"),
        metavar="DIR",
        help=f"folder for {PAGE} and its figures (default: %(default)s)",
    )
    parser.add_argument(
        "--records",
        type=Path,
        metavar="DIR",
        help="folder for the records of finished tasks (default: the output folder)",
    )
    parser.add_argument(
        "--jobs",
        type=int,
        default=1,
        metavar="N",
        help="processes on this machine (default: %(default)s)",
    )
    parser.add_argument(
        "--cluster",
        default="",
        metavar="ADDRESS",
        help="run the tasks on the workers of a Dask scheduler, dask://host:port or "
        "tcp://host:port; workers need one thread each and the same packages",
    )
    parser.add_argument(
        "--publish",
        type=Path,
        metavar="DIR",
        help="write the records there, too, reduced to what the page and its tables show; the page "
        "links to these",
    )
    parser.add_argument(
        "--page-only",
        action="store_true",
        help="write the page from the records so far, from any version of the code",
    )
    return parser


@guarded
def run(argv: Sequence[str], interruption: Interruption) -> int:
    """Run the command: a `bo_tuner.cli.common.Run`."""
    parser = make_parser()
    arguments = parser.parse_args(argv)
    if arguments.jobs < 1:
        parser.error(f"--jobs: expected at least 1, found {arguments.jobs}")
    scheme, separator, _ = arguments.cluster.partition("://")
    if arguments.cluster and (not separator or scheme not in ("dask", "tcp")):
        parser.error("--cluster: expected dask://host:port or tcp://host:port")
    folder = arguments.records or arguments.output
    chosen = arguments.experiment or ["paper"]
    experiments = [load_experiment(name) for name in chosen]
    names = [experiment.name for experiment in experiments]
    for name in names:
        if names.count(name) > 1:
            parser.error(f"--experiment: two are named {name}, and would share their records")
    plans = [(experiment, tasks_of(experiment)) for experiment in experiments]
    # All are checked against their records before the first task runs.
    records = [
        Records(
            folder / f"{experiment.name}.jsonl",
            {task.name: task.version for task in tasks},
            any_version=arguments.page_only,
        )
        for experiment, tasks in plans
    ]
    for (experiment, tasks), recorded in zip(plans, records, strict=True):
        left = unfinished(tasks, recorded)
        if left and not arguments.cluster and not arguments.page_only:
            _check_plugins(experiment)
    for (experiment, tasks), recorded in zip(plans, records, strict=True):
        if not arguments.page_only:
            try:
                _carry_out(experiment, tasks, recorded, interruption, arguments)
            except RunError as error:
                _tell(f"error: {error}; finished tasks are on record in {folder}")
                return EXIT_FAULT
            except Interrupted:
                _tell(f"finished tasks are on record in {folder}; the same command resumes")
                raise
    campaigns = []
    shown = arguments.publish or folder
    for whole, name, recorded in zip(experiments, chosen, records, strict=True):
        experiment, missing = on_record(whole, recorded.done)
        path = shown / f"{experiment.name}.jsonl"
        if arguments.publish:
            publish(experiment, recorded.done, path)
        link = _link(path, arguments.output)
        campaigns.append(page.Campaign(experiment, recorded.done, missing, name, link))
    return _write(campaigns, _fronts(folder, shown, arguments.output), arguments.output)


def _check_plugins(experiment: Experiment) -> None:
    """Load the judge and the optimizers, to report at once what is missing."""
    plugins.load(experiment.judge, "judge")
    for name, case in experiment.cases.items():
        for key, row in case.rows.items():
            if row.optimizer:
                plugins.load(row.optimizer, "cases", name, "rows", key, "optimizer")


def _carry_out(
    experiment: Experiment,
    tasks: Sequence[Task],
    records: Records,
    interruption: Interruption,
    arguments: Any,
) -> None:
    commit = provenance.commit({module for task in tasks for module in task.modules})
    if records.done:
        _tell(f"{experiment.name}: {len(records.done)} of {len(tasks)} tasks are on record")

    def tell(record: dict[str, Any]) -> None:
        outcome = f"failed: {record['failed']}" if record["failed"] else "done"
        count = f"{len(records.done)}/{len(tasks)}"
        _tell(f"{experiment.name} {count} {record['task']} {outcome}, {record['wall_seconds']} s")

    with records:
        conduct(
            tasks,
            records,
            interruption,
            jobs=arguments.jobs,
            cluster=arguments.cluster,
            about={"commit": commit},
            tell=tell,
        )


def _link(path: Path, output: Path) -> str:
    """Return a path relative to the page."""
    return Path(os.path.relpath(path, output)).as_posix()


def _fronts(folder: Path, shown: Path, output: Path) -> list[page.Section]:
    """Lay out the comparison of Pareto fronts, if its record is beside the others."""
    path = folder / fronts.RECORD
    if not path.exists():
        return []
    text = path.read_text(encoding="utf-8")
    if shown != folder:
        write_atomically(shown / fronts.RECORD, text)
    return [fronts.section(json.loads(text), _link(shown / fronts.RECORD, output))]


def _write(
    campaigns: Sequence[page.Campaign], further: Sequence[page.Section], output: Path
) -> int:
    parts = []
    failed: dict[str, str] = {}
    for campaign in campaigns:
        parts += page.sections(campaign)
        failed |= {k: r["failed"] for k, r in campaign.done.items() if r["failed"]}
        print(page.numbers(campaign.experiment, campaign.done))
    with writing(output):
        output.mkdir(parents=True, exist_ok=True)
    for part in parts:
        for figure in part.figures:
            write_figure(figure, output / page.FOLDER, [page.FORMAT])
    first = campaigns[0].experiment
    text = page.markdown(
        [*parts, *further], campaigns, first.title or first.name, first.description
    )
    _tell(f"page: {write_atomically(output / PAGE, text)}")
    for name, reason in failed.items():
        _tell(f"{name} failed: {reason}")
    return EXIT_FAULT if failed else EXIT_OK


def _tell(text: str) -> None:
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()
