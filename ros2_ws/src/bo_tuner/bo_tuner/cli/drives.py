"""``validate --drives``: what drives that the search has not used show of those to come."""

import argparse
import contextlib
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from bo_tuner.backends.ros.play.bag import Bag
from bo_tuner.cli.common import Parser, allow_programs, attached, ended
from bo_tuner.cli.exit_codes import EXIT_INFEASIBLE, EXIT_OK
from bo_tuner.cli.extra_runs import complete, make_nodes
from bo_tuner.cli.notify import notify
from bo_tuner.cli.streams import say_error
from bo_tuner.errors import StudyError
from bo_tuner.evidence.next_drive import (
    NextDrive,
    asked_of,
    attempt_in,
    least_drives,
    next_drive,
    write_next_drive,
)
from bo_tuner.evidence.words.next_drive import headline, percent, sentences
from bo_tuner.interruption import Interruption
from bo_tuner.monitoring.display import plain_console, say
from bo_tuner.numerics.sequential import spent
from bo_tuner.plans import Runs
from bo_tuner.storage.record import RunRecord
from bo_tuner.storage.run_folder import RunFolder
from bo_tuner.study.distributions import Discrete
from bo_tuner.study.parts import ROS
from bo_tuner.study.playing import is_bag
from bo_tuner.study.study import Study
from bo_tuner.terminal import print_table
from bo_tuner.text import counted, listed, with_unit
from bo_tuner.trials import Context, Evaluation, Stage, Trial


def expect(
    arguments: argparse.Namespace,
    parser: Parser,
    record: RunRecord,
    trial: Trial,
    ros_arguments: Sequence[str],
    interruption: Interruption,
) -> int:
    """Run a parameter set on drives that were not used; returns the exit code."""
    drives = _bags(arguments.drives, parser)
    study = record.study
    contexts = _contexts(study, drives)
    attach = attached(arguments, parser, ROS, record)
    allow_programs(record, trusted=arguments.trust, attach=attach)
    folder = RunFolder(record.path)
    with contextlib.closing(folder):
        nodes = make_nodes(record, folder, ROS, ros_arguments, interruption, attach=attach)
        number = attempt_in(folder.path)
        _show_too_few(study, len(drives), number)
        defaults = study.search_space().defaults
        evaluations = [
            Evaluation(0, index, Stage.DRAWN, parameters, context, study.seed)
            for index, (context, parameters) in enumerate(
                (context, parameters)
                for context in contexts
                for parameters in (trial.parameters, defaults)
            )
        ]
        plan = Runs(evaluations, "runs")
        left, code = complete(plan, nodes, folder, arguments, interruption)
        if code is not None:
            return code
        done = plan.evaluations
        made = next_drive(study, trial.parameters, done[::2], done[1::2], drives, number)
        written = write_next_drive(folder.path, number, made)
    _show(study, made)
    for sentence in sentences(made):
        say(sentence)
    say(f"written: {written}")
    code = ended(left, EXIT_OK if made.passed else EXIT_INFEASIBLE)
    notify(arguments.notify, record.path, code, headline(made), say_error)
    return code


def refuse_used_bags(study: Study) -> None:
    """Raise `StudyError` if test runs of a study would play bags that the search has used."""
    if study.plays_bags:
        raise StudyError(
            "the study plays bags, which the search has used, so that they prove nothing of other "
            "drives; name some that were not used by --drives"
        )


def _bags(given: Sequence[str], parser: Parser) -> list[str]:
    """Return the full paths of the bags."""
    paths = [Path(item).resolve() for item in given]
    for path in paths:
        if not is_bag(path):
            parser.error(f"--drives: {path}: expected a bag")
    if len(set(paths)) < len(paths):
        parser.error("--drives: a bag is named twice")
    return [str(path) for path in paths]


def _contexts(study: Study, drives: Sequence[str]) -> list[Context]:
    """Return a context for each drive, nominal but for the drive."""
    play = None if study.run is None else study.run.play
    places = [] if play is None else play.names_in_braces
    names = [name for place, name, _ in places if place == ("bag",)]
    variable = study.contexts.get(names[0]) if len(names) == 1 else None
    if play is None or variable is None or not isinstance(variable.distribution, Discrete):
        raise StudyError(
            "plays no bag that is a context; expected contexts: {drive: {bags: [...]}} and "
            'play: "{drive}"'
        )
    (name,) = names
    space = study.context_space()
    nominal = space.to_dict(space.nominal())
    bags = [play.filled({**nominal, name: value}).bag for value in variable.distribution.values]
    # Pieces of a bag are of one drive.
    used = [Bag(Path(study.folder) / bag) for bag in dict.fromkeys(bags)]
    named: list[Bag] = []
    for drive in drives:
        bag = Bag(Path(drive))
        for others, what in ((used, "that the search has used"), (named, "that is also named")):
            for other in others:
                if bag.overlaps(other) or bag.path == other.path.resolve():
                    raise StudyError(
                        f"{drive} is of a drive {what}, {other.path.name}; expected others"
                    )
        named.append(bag)
    return [{**nominal, name: drive} for drive in drives]


def _show_too_few(study: Study, count: int, attempt: int) -> None:
    """Say ahead of the runs that no outcome of them is a PASS, which costs later calls."""
    asked, confidence = asked_of(study), spent(study.certificate.confidence, attempt)
    if (least := least_drives(asked, confidence)) > count:
        say(
            f"note: {counted(count, 'drive')} cannot show {percent(asked)}, for which it takes "
            f"{least} at least in this call, and more in a further one"
        )


def _show(study: Study, made: NextDrive) -> None:
    names = [study.objective.metric, *(item.metric for item in study.constraints.values())]
    metrics = list(dict.fromkeys(names))
    table = Table(title="drives that the search has not used", title_justify="left")
    table.add_column("drive")
    for name in metrics:
        metric = study.metrics[name]
        table.add_column(with_unit(metric.title, metric.unit), justify="right")
        table.add_column("default", justify="right")
    table.add_column("")
    for run in made.runs:
        cells = [
            f"{values[name]:.4g}" if values else "failed"
            for name in metrics
            for values in (run.tuned, run.default)
        ]
        beyond = [study.limit_title(study.constraints[name]) for name in run.beyond]
        words = f"beyond {listed(beyond)}" if beyond else ""
        table.add_row(Path(run.drive).name, *cells, words)
    print_table(plain_console(), table)
