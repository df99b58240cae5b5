"""Tuned nodes that steps of a run configure: what they have then stays in force until the next."""

import json
from collections.abc import Iterator

from bo_tuner.errors import StudyError
from bo_tuner.study.run import Run
from bo_tuner.study.steps import Step

CHANGE_STATE = "change_state"
"""Service of a lifecycle node."""
CONTROLLER_SERVICES = ("configure_controller", "switch_controller", "load_controller")
"""Services of a controller_manager after which a controller may have other values in force."""


def configured_by_steps(run: Run | None, tuned: frozenset[str]) -> list[str]:
    """Return the nodes, of those with these names, that steps of `before` configure."""
    steps = () if run is None else run.before
    return sorted({node for step in steps for node in tuned if _configures(step, node)})


def check_parked(configured: list[str]) -> None:
    """Refuse to have nodes configured in `before` while they have the safe parameters.

    If they read them only then, they would keep them in the run, and nobody would notice.

    Raises
    ------
    StudyError
        If there is one.
    """
    if configured:
        raise StudyError(
            f"a step of run.before configures {configured[0]}, which has the safe parameters then "
            "and may keep them in the run; expected false, or reconfigure under this node in "
            "place of the step",
            ("park", "between_runs"),
        )


def stays_in_force(configured: list[str]) -> Iterator[str]:
    """Yield a sentence on each node that keeps a trial's values in force after the end."""
    for node in configured:
        yield (
            f"a step of run.before configures {node}: what it read then stays in force after the "
            "end, when its parameters are set back; with reconfigure under this node in place of "
            "the step (docs/procedure.md) the tuner, its guard and apply bring values into force"
        )


def is_named(node: str, named: str) -> bool:
    """Return whether a step names a node; maybe with a namespace, which the study does not know."""
    return f"/{named.strip('/')}".endswith(f"/{node.strip('/')}")


def _configures(step: Step, node: str) -> bool:
    change, call = step.lifecycle, step.call
    if change is not None:
        return change.transition == "configure" and is_named(node, change.node)
    if call is None:
        return False
    owner, _, service = call.service.rpartition("/")
    if service == CHANGE_STATE:
        return is_named(node, owner)
    name = node.rpartition("/")[2]
    return service in CONTROLLER_SERVICES and json.dumps(name) in json.dumps(call.request)
