"""Values of contexts and parameters in the steps of a run, by names in braces."""

import dataclasses
from collections.abc import Collection, Iterator, Mapping
from itertools import takewhile
from typing import Any

from bo_tuner.codec import checks
from bo_tuner.codec.findings import Findings
from bo_tuner.errors import KeyPath, StudyError, dotted
from bo_tuner.study.braces import Values, filled, filled_condition, names_in
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.parts import ContextVariable
from bo_tuner.study.run import AFTER, BEFORE, REST, START, Run
from bo_tuner.study.steps import Step

_CONTENTS = {"publish": "message", "call": "request", "send_goal": "goal"}
"""Kinds of steps that send something, each with the key of its content."""


def filled_step(step: Step, values: Values) -> Step:
    """Return a step of a run with values for names in braces."""
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


def senders(run: Run | None, name: str) -> list[str]:
    """Return the places of the steps ahead of and in a run that have a name in braces."""
    steps = () if run is None else run.steps
    return [
        dotted(path)
        for path, step in steps
        if path[1] in (BEFORE, START) and any(found == name for _, found in _names(step))
    ]


def left_by_calls(run: Run, parameters: Collection[str]) -> Iterator[str]:
    """Yield a sentence on each call with a parameter that no step of ``after`` takes back."""
    steps = list(run.steps)
    taken_back = {step.call.service for path, step in steps if path[1] == AFTER and step.call}
    for path, step in steps:
        if step.call is None or path[1] not in (BEFORE, START) or step.call.service in taken_back:
            continue
        names = [name for _, name in _names(step) if name in parameters]
        if names:
            yield (
                f"{dotted(path)} sends {names[0]} of the trial, which stays in force after the "
                "run: put the same call into run.after, where it sends the safe value"
            )


def check_braces(
    run: Run | None,
    contexts: Mapping[str, ContextVariable | None],
    parameters: Mapping[str, Parameter | None],
) -> None:
    """Refuse names in braces that name nothing, or stand where none can, and what is not used.

    Parameters
    ----------
    run
        The run, if the study has one.
    contexts, parameters
        The context variables and parameters by name; None for one that is wrong itself.
    """
    findings = Findings()
    used: set[str] = set()
    known = {**parameters, **contexts}
    for path, name, in_condition in () if run is None else _all_names(run):
        used.add(name)
        with findings.under():
            checks.reference(name, "context or parameter", known, *path)
            if name in contexts and name in parameters:
                raise StudyError(f"'{name}' is both a context and a parameter; rename one", path)
            item = known[name]
            if in_condition and item is not None and item.type == "string":
                raise StudyError(f"'{name}' is a text, which no condition on signals has", path)
    for section, items in (("contexts", contexts), ("parameters", parameters)):
        for name, variable in items.items():
            if variable is not None and not variable.node and name not in used:
                with findings.under():
                    raise StudyError(
                        f"is used nowhere; expected node, or {{{name}}} in a step of run",
                        (section, name),
                    )
    for path, text, why in () if run is None else _without_names(run):
        for name in names_in(text):
            with findings.under():
                raise StudyError(f"expected no name in braces, found '{name}': {why}", path)
    for path, text in () if run is None else _stopping(run):
        for name in names_in(text):
            if name in contexts:
                with findings.under():
                    raise StudyError(
                        f"expected no context, found '{name}': it must hold whatever a test run is",
                        path,
                    )
    findings.check()


def _all_names(run: Run) -> Iterator[tuple[KeyPath, str, bool]]:
    """Yield each name in braces with its place, and whether it is in a condition."""
    for path, step in run.steps:
        for below, name in _names(step):
            yield (*path, *below), name, step.wait_until is not None
    for name in names_in(run.end.when):
        yield ("run", "end", "when"), name, True


def _stopping(run: Run) -> Iterator[tuple[KeyPath, Any]]:
    """Yield the messages, with their places, that a guard sends to bring the machine to rest."""
    for index, step in enumerate(run.after):
        if step.publish is None:
            return
        yield ("run", AFTER, index, "publish", "message"), step.publish.message


def _without_names(run: Run) -> Iterator[tuple[KeyPath, Any, str]]:
    """Yield what has no names in braces, with its place and why."""
    holds = "it must hold whatever a test run is"
    yield ("run", "abort_when"), run.abort_when, holds
    if run.rest is not None:
        yield ("run", REST, "until"), run.rest.until, holds
    for path, step in run.steps:
        if step.set is not None:
            yield (*path, "set", "value"), step.set.value, "a value that is set has none in it"
        if step.publish is None or not step.publish.streams:
            continue
        for below, topic in zip(step.publish.paths, step.publish.published, strict=True):
            key_path = (*path, "publish", *below)
            yield (*key_path, "message"), topic.message, "a stream has none in it"
            for name, profile in topic.profile.items():
                yield (*key_path, "profile", name), profile.expression, "a stream has none in it"


def _names(step: Step) -> Iterator[tuple[KeyPath, str]]:
    """Yield the names in braces in a step, with their places below it."""
    for kind, key in _CONTENTS.items():
        if (spec := getattr(step, kind)) is not None:
            for name in names_in(getattr(spec, key)):
                yield (kind, key), name
    if step.wait_until is not None:
        for name in names_in(step.wait_until.condition):
            yield ("wait_until", "condition"), name
