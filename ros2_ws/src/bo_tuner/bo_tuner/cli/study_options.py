"""The study that a command is given, and the options that change it."""

import argparse
import contextlib
from collections.abc import Iterator, Sequence
from functools import partial
from typing import TypeVar

from bo_tuner.backends.ros.graph import describe_nodes
from bo_tuner.cli.common import Group, whole_number
from bo_tuner.errors import OutputError, StudyError
from bo_tuner.interruption import Interruption
from bo_tuner.storage.parameter_set_file import read_parameter_set
from bo_tuner.storage.trust import trust
from bo_tuner.study.other_space import with_bounds, with_fixed
from bo_tuner.study.parameter import Number
from bo_tuner.study.strict_yaml import plain_scalar
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import load_study
from bo_tuner.trials import Value

T = TypeVar("T")


def add_budget_arguments(group: Group) -> None:
    """Add the options that change budget and seed."""
    group.add_argument(
        "--trials",
        type=whole_number,
        metavar="N",
        help="number of trials, in place of the study's budget of trials and test runs; the "
        "initial design has at most as many",
    )
    group.add_argument(
        "--evaluations",
        type=whole_number,
        metavar="N",
        help="number of test runs of all trials, in place of the study's budget",
    )
    group.add_argument(
        "--seed",
        type=whole_number,
        metavar="N",
        help="random seed of the run (default: the study's)",
    )


def add_bounds_argument(group: Group) -> None:
    """Add the options that change the bounds of parameters, or take them out of the search."""
    group.add_argument(
        "--bounds",
        type=_bounds,
        action="append",
        metavar="NAME=LOWER:UPPER",
        help="other bounds of a tuned number than the study has, such as kp=0.1:20; once for each",
    )
    group.add_argument(
        "--fix",
        type=_fixed,
        action="append",
        metavar="NAME=VALUE",
        help="keep a tuned parameter at a value, such as kp=2.0; once for each",
    )


def add_attach_argument(group: Group) -> None:
    """Add the option of a command that starts what does not run."""
    group.add_argument(
        "--attach",
        action=argparse.BooleanOptionalAction,
        help="use running nodes, or with --no-attach start them (default: start them where the "
        "study says how, and none of them is running)",
    )


def read_study(
    named: str, attach: bool, ros_arguments: Sequence[str], interruption: Interruption
) -> Study:
    """Read a study by its name or path."""
    describe = partial(describe_nodes, ros_arguments=ros_arguments, interrupted=interruption.check)
    return load_study(named, describe if attach else None)


def changed_study(study: Study, arguments: argparse.Namespace, namespace: str) -> Study:
    """Return a study with the options of the command line."""
    if arguments.bounds:
        bounds = _each_once("--bounds", arguments.bounds)
        with _in_option("--bounds"):
            study = with_bounds(study, bounds)
    if arguments.fix:
        values = _each_once("--fix", arguments.fix)
        with _in_option("--fix"):
            study = with_fixed(study, values)
    sets = [
        read_parameter_set(path, study, namespace)
        for path in getattr(arguments, "start", None) or ()
    ]
    try:
        return study.replace(
            trials=arguments.trials,
            evaluations=arguments.evaluations,
            seed=arguments.seed,
            start=sets,
        )
    except StudyError as error:
        option = error.path[-1] if error.path else ""
        raise StudyError(f"--{option}: {error.problem}") from error


def trust_given(study: Study) -> None:
    """Trust a study that the user has given to be run.

    Where that cannot be noted down, commands on its run ask for ``--trust``.
    """
    with contextlib.suppress(OutputError):
        trust(study)


def _each_once(option: str, given: Sequence[tuple[str, T]]) -> dict[str, T]:
    """Return what an option says by name, which it may say once for each."""
    names = [name for name, _ in given]
    if twice := [name for name in names if names.count(name) > 1]:
        raise StudyError(f"{option}: {twice[0]} has more than one; leave all but one out")
    return dict(given)


@contextlib.contextmanager
def _in_option(option: str) -> Iterator[None]:
    try:
        yield
    except StudyError as error:
        raise StudyError(f"{option}: {error}") from error


def _fixed(text: str) -> tuple[str, Value]:
    """Read the name of a parameter, and its value."""
    name, _, value = text.partition("=")
    found = plain_scalar(value)
    if not name or found is None:
        raise argparse.ArgumentTypeError(f"{text}: expected NAME=VALUE, such as kp=2.0")
    return name, found


def _bounds(text: str) -> tuple[str, tuple[Number, Number]]:
    """Read the name of a parameter, and its bounds."""
    name, _, pair = text.rpartition("=")
    lower, _, upper = pair.partition(":")
    try:
        if not name:
            raise ValueError
        return name, (_number(lower), _number(upper))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text}: expected NAME=LOWER:UPPER, such as kp=0.1:20"
        ) from None


def _number(text: str) -> Number:
    """Read a number; an integer parameter takes no 3.0."""
    try:
        return int(text)
    except ValueError:
        return float(text)
