"""Values of contexts and parameters in steps of a run and starts of nodes, by names in braces."""

import dataclasses
from collections.abc import Collection, Iterator, Mapping
from itertools import takewhile
from typing import Any

from bo_tuner.codec import checks
from bo_tuner.codec.findings import Findings
from bo_tuner.errors import KeyPath, StudyError, dotted
from bo_tuner.study.braces import Values, filled, filled_condition, names_in
from bo_tuner.study.nodes import NodeSpec
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.parts import ContextVariable
from bo_tuner.study.run import AFTER, BEFORE, REST, START, Run
from bo_tuner.study.steps import Step

_CONTENTS = {"call": "request", "send_goal": "goal"}
"""Kinds of steps that send something once, each with the key of its content."""


def filled_step(step: Step, values: Values) -> Step:
    """Return a step of a run with values for names in braces."""
    if step.publish is not None:
        return dataclasses.replace(step, publish=step.publish.filled(values))
    if step.play is not None:
        return dataclasses.replace(step, play=step.play.filled(values))
    for kind, key in _CONTENTS.items():
        spec = getattr(step, kind)
        if spec is not None:
            content = filled(getattr(spec, key), values)
            return dataclasses.replace(step, **{kind: dataclasses.replace(spec, **{key: content})})
    if step.wait_until is not None:
        condition = filled_condition(step.wait_until.condition, values)
        wait = dataclasses.replace(step.wait_until, condition=condition)
        return dataclasses.replace(step, wait_until=wait)
    return step


def varies(step: Step) -> bool:
    """Whether a step has the value of a context or a parameter in it."""
    return any(True for _ in _names(step))


def filled_after(run: Run, safe: Values) -> tuple[Step, ...]:
    """Return the steps of ``after`` up to the first that sends no message, with safe values."""
    head = takewhile(lambda step: step.publish is not None, run.after)
    return tuple(filled_step(step, safe) for step in head)


def senders(run: Run | None, nodes: Mapping[str, NodeSpec], name: str) -> list[str]:
    """Return the steps ahead of and in a run, and what starts a node, with a name in braces."""
    steps = () if run is None else run.steps
    in_steps = [
        dotted(path)
        for path, step in steps
        if path[1] in (BEFORE, START) and any(found == name for _, found, _ in _names(step))
    ]
    return in_steps + [dotted(path) for path, found in _at_start(nodes) if found == name]


def left_by_calls(run: Run, parameters: Collection[str]) -> Iterator[str]:
    """Yield a sentence on each call with a parameter that no step of ``after`` takes back."""
    steps = list(run.steps)
    taken_back = {step.call.service for path, step in steps if path[1] == AFTER and step.call}
    for path, step in steps:
        if step.call is None or path[1] not in (BEFORE, START) or step.call.service in taken_back:
            continue
        names = [name for _, name, _ in _names(step) if name in parameters]
        if names:
            yield (
                f"{dotted(path)} sends {names[0]} of the trial, which stays in force after the "
                "run: put the same call into run.after, where it sends the safe value"
            )


def check_braces(
    run: Run | None,
    nodes: Mapping[str, NodeSpec],
    contexts: Mapping[str, ContextVariable | None],
    parameters: Mapping[str, Parameter | None],
) -> None:
    """Refuse names in braces that name nothing, or stand where none can, and what is not used.

    Parameters
    ----------
    run
        The run, if the study has one.
    nodes
        The nodes by key.
    contexts, parameters
        The context variables and parameters by name; None for one that is wrong itself.
    """
    findings = Findings()
    used: set[str] = set()
    known = {**parameters, **contexts}
    at_start = ((*place, False) for place in _at_start(nodes))
    for path, name, is_number in (*(() if run is None else _all_names(run)), *at_start):
        used.add(name)
        with findings.under():
            _check_name(name, known, path)
            if name in contexts and name in parameters:
                raise StudyError(f"'{name}' is both a context and a parameter; rename one", path)
            item = known[name]
            if isinstance(item, Parameter) and item.is_list:
                raise StudyError(f"'{name}' is a list, which stands in no braces", path)
            if is_number and item is not None and item.type == "string":
                raise StudyError(f"'{name}' is a text; expected a number or a truth value", path)
    for section, items in (("contexts", contexts), ("parameters", parameters)):
        for name, variable in items.items():
            if variable is not None and not variable.node and name not in used:
                with findings.under():
                    raise StudyError(
                        f"is used nowhere; expected node, or {{{name}}} in a step of run or in "
                        "what starts a node",
                        (section, name),
                    )
    for path, text, why in () if run is None else _without_names(run):
        for name in names_in(text):
            with findings.under():
                raise StudyError(f"expected no name in braces, found '{name}': {why}", path)
    for path, name in () if run is None else _stopping(run):
        if name in contexts:
            with findings.under():
                raise StudyError(
                    f"expected no context, found '{name}': it must hold whatever a test run is",
                    path,
                )
    findings.check()


def _check_name(name: str, known: Collection[str], path: KeyPath) -> None:
    """Refuse a name in braces that is none of a context or a parameter."""
    try:
        checks.reference(name, "context or parameter", known, *path)
    except StudyError as error:
        if path[0] != "nodes":
            raise
        literal = f"write {{{{{name}}}}} for the text {{{name}}}"
        raise StudyError(f"{error.problem}; {literal}", path) from None


def _at_start(nodes: Mapping[str, NodeSpec]) -> Iterator[tuple[KeyPath, str]]:
    """Yield each name in braces in what starts a node, with its place."""
    for key, spec in nodes.items():
        for below, name in spec.names_in_braces:
            yield ("nodes", key, *below), name


def _all_names(run: Run) -> Iterator[tuple[KeyPath, str, bool]]:
    """Yield each name in braces with its place, and whether a number must stand there."""
    for path, step in run.steps:
        for below, name, is_number in _names(step):
            yield (*path, *below), name, is_number
    for name in names_in(run.end.when):
        yield ("run", "end", "when"), name, True


def _stopping(run: Run) -> Iterator[tuple[KeyPath, str]]:
    """Yield the names, with their places, in what a guard sends to bring the machine to rest."""
    for index, step in enumerate(run.after):
        if step.publish is None:
            return
        for below, name, _ in _names(step):
            yield ("run", AFTER, index, *below), name


def _without_names(run: Run) -> Iterator[tuple[KeyPath, Any, str]]:
    """Yield what has no names in braces, with its place and why."""
    holds = "it must hold whatever a test run is"
    yield ("run", "abort_when"), run.abort_when, holds
    if run.rest is not None:
        yield ("run", REST, "until"), run.rest.until, holds
    for path, step in run.steps:
        if step.set is not None:
            yield (*path, "set", "value"), step.set.value, "a value that is set has none in it"


def _names(step: Step) -> Iterator[tuple[KeyPath, str, bool]]:
    """Yield the names in braces in a step, with places below it; whether a number stands there."""
    for kind, spec in (("publish", step.publish), ("play", step.play)):
        for below, name, is_number in () if spec is None else spec.names_in_braces:
            yield (kind, *below), name, is_number
    for kind, key in _CONTENTS.items():
        if (spec := getattr(step, kind)) is not None:
            for name in names_in(getattr(spec, key)):
                yield (kind, key), name, False
    if step.wait_until is not None:
        for name in names_in(step.wait_until.condition):
            yield ("wait_until", "condition"), name, True
