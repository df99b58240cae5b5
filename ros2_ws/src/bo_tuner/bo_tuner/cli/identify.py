"""``identify``: where in the contexts of a study a machine is, by a few of its runs."""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rich.table import Table

from bo_tuner import maxima
from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.cli.common import (
    Parser,
    fraction,
    guarded,
    named_metrics,
    opened,
    run_folder,
    whole_number,
)
from bo_tuner.cli.exit_codes import EXIT_INFEASIBLE, EXIT_OK
from bo_tuner.codec import checks
from bo_tuner.errors import RunRecordError, StudyError
from bo_tuner.interruption import Interruption
from bo_tuner.models.context_posterior import LEAST_SIMULATED
from bo_tuner.monitoring.display import plain_console, say
from bo_tuner.replay.context_figure import context_figure
from bo_tuner.replay.identification import (
    MOST_SETS,
    SIMULATIONS,
    WAVES,
    Identification,
    identify,
)
from bo_tuner.replay.machine_runs import MachineRuns, machine_runs
from bo_tuner.report.page import FORMATS, write_figure
from bo_tuner.storage.atomic import write_atomically
from bo_tuner.storage.run_folder import JOURNAL
from bo_tuner.study import strict_yaml
from bo_tuner.study.distributions import Discrete, Distribution
from bo_tuner.study.narrowing import beyond, narrowed
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import (
    load_study,
    read_text,
    study_from_mapping,
    study_to_mapping,
    study_to_yaml,
)
from bo_tuner.terminal import print_table
from bo_tuner.text import counted, printable, shown
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.gate import Gate
from bo_tuner.tuning.observer import NOBODY

CREDIBLE = 0.99
"""Probability that the machine is within all bounds that are written."""
LEVEL = 0.01
"""Probability of naming a misfit where there is none, at most."""

DESCRIPTION = """\
Infer from a few runs of a machine where in the contexts of a study it is, and
write the study with the narrower distribution. The study's simulator is run in
this process at the parameters of those runs, over its contexts; what fits the
metrics of the machine stays. If no context explains them, that is said, and
nothing is written.
"""

EPILOG = """\
The runs are those of a run folder, or of bags in its folder bags, whose study
has the same parameters and metrics and sets no context. Measured times are not
compared. The contexts to infer from may be wider than those of the study: a
file with a section `contexts` as in a study.

exit codes:
  0    the narrower study is written
  1    the simulation had to stop, or standard output cannot be written
  2    bad input: runs, study or option, or a file that cannot be written
  3    no context explains the runs; nothing is written
  130  interrupted by Ctrl-C (143: by SIGTERM, 129: the terminal was closed,
       141: the output pipe was closed)

examples:
  identify runs/machine --study axis.yaml --output narrower.yaml
  identify runs/machine --trial 0 --study axis.yaml --output narrower.yaml
  identify runs/machine/bags/trial_0000 --study axis.yaml --output narrower.yaml
  identify latest --study axis.yaml --contexts wider.yaml --output narrower.yaml
  identify latest --study axis.yaml --output narrower.yaml --figures plots
"""


def make_parser() -> Parser:
    """Return the parser of the command line."""
    parser = Parser("identify", DESCRIPTION, EPILOG)
    parser.add_run_argument("run folder of the machine, or bags of one", several=True)
    parser.add_argument(
        "--study", required=True, metavar="NAME|FILE", help="study with the simulator's objects"
    )
    parser.add_argument(
        "--output", required=True, type=Path, metavar="FILE", help="study file to write"
    )
    parser.add_argument(
        "--contexts",
        type=Path,
        metavar="FILE",
        help="infer within these contexts (default: those of the study)",
    )
    parser.add_argument(
        "--trial", type=whole_number, metavar="N", help="only the runs of this trial (default: all)"
    )
    parser.add_argument(
        "--metrics",
        metavar="NAME,...",
        help="metrics to compare (default: all that both have, but measured times and what is "
        "computed from others)",
    )
    parser.add_argument(
        "--simulations",
        type=whole_number,
        default=SIMULATIONS,
        metavar="N",
        help=f"runs of the simulator at each parameter set, {WAVES} times (default: {SIMULATIONS})",
    )
    parser.add_argument(
        "--credible",
        type=fraction,
        default=CREDIBLE,
        metavar="P",
        help=f"probability of all bounds that are written (default: {CREDIBLE})",
    )
    parser.add_argument(
        "--level",
        type=fraction,
        default=LEVEL,
        metavar="P",
        help=f"probability of naming a misfit where there is none, at most (default: {LEVEL})",
    )
    parser.add_argument(
        "--figures", type=Path, metavar="DIR", help="also write a figure to this folder"
    )
    return parser


@guarded
def run(argv: Sequence[str], interruption: Interruption) -> int:
    """Run the command: a `common.Run`."""
    parser = make_parser()
    arguments = parser.parse_args(argv)
    if not LEAST_SIMULATED <= arguments.simulations <= maxima.TEST_RUNS:
        parser.error(
            f"--simulations: expected {LEAST_SIMULATED} to {maxima.TEST_RUNS}, "
            f"found {arguments.simulations}"
        )
    _check_output(arguments, parser)
    study = load_study(arguments.study)
    box = study if arguments.contexts is None else _within(study, arguments.contexts)
    _check_simulator(box, str(arguments.study))
    machine = _machine(arguments, box)
    simulator = InProcessBackend(box, interruption.check)
    with opened(simulator, interruption, again=True):
        _announce(machine, arguments.simulations)
        driver = Driver(simulator, gate=Gate(interruption.check, NOBODY))
        identified = identify(box, machine, driver, arguments.simulations)
    say(f"compared: {', '.join(machine.metrics)}")
    if misfits := identified.misfits(arguments.level):
        _show_misfits(misfits, arguments.level)
        return EXIT_INFEASIBLE
    narrower = narrowed(box, identified.posterior.contexts, arguments.credible)
    _show(identified, narrower)
    for name, share in beyond(study, box, identified.posterior.contexts).items():
        say(f"note: {name} is beyond the contexts of the study with a probability of {share:.2g}")
    text = _heading(machine, arguments) + study_to_yaml(narrower)
    say(f"study: {write_atomically(arguments.output, text)}")
    if arguments.figures is not None:
        for path in write_figure(context_figure(identified, narrower), arguments.figures, FORMATS):
            say(f"figure: {path}")
    return EXIT_OK


def _check_output(arguments: argparse.Namespace, parser: Parser) -> None:
    """Refuse, ahead of the simulation, a file that cannot be made or that is an input."""
    output: Path = arguments.output
    if not output.name:
        parser.error("--output: expected the name of a file")
    if not output.absolute().parent.is_dir():
        parser.error(f"--output: {output}: there is no folder {output.parent}")
    if (output.parent / JOURNAL).exists():
        parser.error(f"--output: {output}: is in a run folder; give another name")
    inputs = [Path(given) for given in (arguments.study, arguments.contexts) if given is not None]
    if output.exists() and any(path.exists() and path.samefile(output) for path in inputs):
        parser.error(f"--output: {output}: is an input; give another name")


def _within(study: Study, path: Path) -> Study:
    """Return a study with the contexts of a file in place of its own."""
    source = str(path)
    document = strict_yaml.parse(read_text(path, source)).value
    if not isinstance(document, dict) or list(document) != ["contexts"]:
        raise StudyError(
            f"expected a section contexts alone, found {checks.show(document)}", source=source
        )
    try:
        wider = study_from_mapping(study_to_mapping(study) | document)
    except StudyError as error:
        raise error.located(source, None) from None
    # What was read from files beside the study is kept.
    return replace(study, contexts=wider.contexts)


def _check_simulator(study: Study, source: str) -> None:
    """Refuse a study without contexts, or without objects that run in this process."""
    if not study.contexts:
        raise StudyError("has no contexts to infer; add some, or give --contexts", source=source)
    without = [key for key, node in study.nodes.items() if not node.object]
    if study.trigger is None or without:
        which = f"node {', '.join(without)} has no object" if without else "it has no trigger"
        raise StudyError(
            f"has no simulator: {which}; expected a trigger, and an object of each node to run in "
            "this process",
            source=source,
        )


def _machine(arguments: argparse.Namespace, study: Study) -> MachineRuns:
    """Return the runs of the machine."""
    metrics = None if arguments.metrics is None else named_metrics(arguments.metrics, study)
    paths = [run_folder(path) for path in arguments.run]
    machine = machine_runs(paths, study, metrics, arguments.trial)
    if len(machine.sets) > MOST_SETS:
        raise RunRecordError(
            f"{' and '.join(map(str, paths))}: runs of {len(machine.sets)} parameter sets; "
            f"expected at most {MOST_SETS}: name one by --trial"
        )
    return machine


def _announce(machine: MachineRuns, simulations: int) -> None:
    sets = counted(len(machine.sets), "parameter set")
    total = WAVES * simulations * len(machine.sets)
    say(f"{counted(machine.count, 'run')} of the machine with {sets}; {total} simulations")
    if machine.left_out:
        say(f"left out: {counted(machine.left_out, 'run')} that did not complete")


def _show_misfits(misfits: Sequence[str], level: float) -> None:
    say(f"no context explains the runs of the machine, at a level of {level:g}:")
    for line in misfits:
        say(f"  {line}")
    say(
        "nothing is written: the machine differs from the simulator in something else than these "
        "contexts; give the simulator that as a context, or wider ones with --contexts"
    )


def _show(identified: Identification, narrower: Study) -> None:
    table = Table(title="where the machine is", title_justify="left")
    for heading in ("context", "unit"):
        table.add_column(heading)
    for heading in ("searched", "mean", "deviation", "written"):
        table.add_column(heading, justify="right")
    for column, (name, variable) in enumerate(identified.study.contexts.items()):
        values = identified.posterior.contexts[:, column]
        after = narrower.contexts[name].distribution
        # Labels have no mean.
        moments = [""] * 2 if after.labels else [f"{values.mean():.4g}", f"{values.std():.2g}"]
        cells = (_support(variable.distribution), *moments, _support(after))
        table.add_row(name, variable.unit, *cells)
    print_table(plain_console(), table)


def _support(distribution: Distribution) -> str:
    """Return the values of a distribution in a few words."""
    if isinstance(distribution, Discrete):
        return ", ".join(shown(value) for value in distribution.values)
    return f"{distribution.lower:.4g} to {distribution.upper:.4g}"


def _heading(machine: MachineRuns, arguments: argparse.Namespace) -> str:
    """Return a comment on where the contexts come from."""
    runs = printable(", ".join(map(str, arguments.run)))
    return (
        f"# Contexts by identify, from {counted(machine.count, 'run')} of {runs}:\n"
        f"# the machine is within all bounds with a probability of {arguments.credible:g}.\n"
    )
