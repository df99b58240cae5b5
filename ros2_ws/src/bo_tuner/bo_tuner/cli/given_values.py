"""Values that somebody else tuned, which ``validate`` certifies without a run."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bo_tuner.backends.ros.isolation import named_namespace
from bo_tuner.cli.common import RUNS, Group, Parser
from bo_tuner.cli.study_options import read_study, trust_given
from bo_tuner.evidence.certificate.given import check_folder, given_values
from bo_tuner.interruption import Interruption
from bo_tuner.storage.atomic import writing
from bo_tuner.storage.parameter_set_file import read_parameter_set
from bo_tuner.storage.record import RunRecord
from bo_tuner.storage.run_folder import RunFolder
from bo_tuner.study.parts import BACKENDS
from bo_tuner.trials import Trial

OF_A_RUN = ("trial", "until_pass")
"""Options that choose among the trials of a run."""


def add_given_arguments(group: Group) -> None:
    """Add the options that name values, their study, and where their certificates are kept."""
    group.add_argument(
        "--parameters",
        type=Path,
        metavar="FILE",
        help="in place of RUN, the values in this file, whoever has tuned them: values by name, "
        "or a parameter file of nodes; values missing from it take their defaults",
    )
    group.add_argument(
        "--study",
        metavar="NAME|FILE",
        help="with --parameters: the shipped study, or study file, with contexts and limits",
    )
    group.add_argument(
        "--output",
        type=Path,
        metavar="DIR",
        help="with --parameters: folder of the certificates, which share the confidence "
        f"(default: {RUNS}/STUDY-given)",
    )


@dataclass(frozen=True)
class Given:
    """Values to be certified.

    Attributes
    ----------
    record
        Without a trial; its folder need not exist yet.
    trial
        Stands for the values.
    """

    record: RunRecord
    trial: Trial

    def open_folder(self) -> RunFolder:
        """Make the folder if need be, with the study in it, and lock it."""
        path = self.record.path
        with writing(path):
            path.mkdir(parents=True, exist_ok=True)
        folder = RunFolder(path)
        folder.write_study(self.record.study)
        return folder


def given(
    arguments: argparse.Namespace,
    parser: Parser,
    ros_arguments: Sequence[str],
    interruption: Interruption,
) -> Given | None:
    """Return the values that the options name; None if the command is about a run."""
    if arguments.parameters is None:
        for name in ("study", "output"):
            if getattr(arguments, name) is not None:
                parser.error(f"--{name} needs --parameters")
        if arguments.run is None:
            parser.error("the following arguments are required: RUN, or --parameters and --study")
        return None
    if arguments.run is not None:
        parser.error(f"--parameters is in place of a run; leave {arguments.run} out")
    if arguments.study is None:
        parser.error("--parameters needs --study")
    for name in OF_A_RUN:
        if getattr(arguments, name) != parser.get_default(name):
            parser.error(f"--{name.replace('_', '-')} is of a run; leave it out with --parameters")
    attach = bool(arguments.attach)
    study = read_study(arguments.study, attach, ros_arguments, interruption)
    values = read_parameter_set(arguments.parameters, study, named_namespace(ros_arguments))
    path = (arguments.output or RUNS / f"{study.name}-given").absolute()
    record, trial = given_values(study, values, path, arguments.backend or BACKENDS[0])
    check_folder(record)
    trust_given(study)
    return Given(record, trial)
