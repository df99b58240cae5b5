"""Values of contexts in the steps of a run, by names in braces (`bo_tuner.study.braces`)."""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

from bo_tuner.errors import KeyPath, StudyError
from bo_tuner.study import checks
from bo_tuner.study.braces import filled, filled_condition, names_in
from bo_tuner.study.building import Findings
from bo_tuner.study.parts import ContextVariable
from bo_tuner.study.run import AFTER, REST, Run
from bo_tuner.study.steps import Step
from bo_tuner.trials import Context

_CONTENTS = {"publish": "message", "call": "request", "send_goal": "goal"}
"""Kinds of steps that send something, each with the key of its content."""


def filled_step(step: Step, context: Context) -> Step:
    """Return a step of a run with the values of a context."""
    for kind, key in _CONTENTS.items():
        spec = getattr(step, kind)
        if spec is not None:
            content = filled(getattr(spec, key), context)
            return dataclasses.replace(step, **{kind: dataclasses.replace(spec, **{key: content})})
    if step.wait_until is not None:
        condition = filled_condition(step.wait_until.condition, context)
        wait = dataclasses.replace(step.wait_until, condition=condition)
        return dataclasses.replace(step, wait_until=wait)
    return step


def varies(step: Step) -> bool:
    """Whether a step has the value of a context in it."""
    return any(True for _ in _names(step))


def check_contexts(run: Run | None, contexts: Mapping[str, ContextVariable | None]) -> None:
    """Refuse names in braces that are no contexts, or stand where none can, and unused contexts.

    Parameters
    ----------
    run
        The run, if the study has one.
    contexts
        The context variables by name; None for one that is wrong itself.
    """
    findings = Findings()
    used: set[str] = set()
    for path, name, in_condition in () if run is None else _all_names(run):
        used.add(name)
        with findings.under():
            checks.reference(name, "context", contexts, *path)
            variable = contexts[name]
            if in_condition and variable is not None and variable.type == "string":
                raise StudyError(f"'{name}' is a text, which no condition on signals has", path)
    for path, text in () if run is None else _without_context(run):
        for name in names_in(text):
            with findings.under():
                raise StudyError(
                    f"expected no context, found '{name}': it must hold whatever a test run is",
                    path,
                )
    for path, text in () if run is None else _in_streams(run):
        for name in names_in(text):
            with findings.under():
                raise StudyError(
                    f"expected no context, found '{name}': a stream has none in it", path
                )
    for name, variable in contexts.items():
        if variable is not None and not variable.node and name not in used:
            with findings.under():
                raise StudyError(
                    f"is used nowhere; expected node, or {{{name}}} in a step of run",
                    ("contexts", name),
                )
    findings.check()


def _all_names(run: Run) -> Iterator[tuple[KeyPath, str, bool]]:
    """Yield each name in braces with its place, and whether it is in a condition."""
    for path, step in run.steps:
        for below, name in _names(step):
            yield (*path, *below), name, step.wait_until is not None
    for name in names_in(run.end.when):
        yield ("run", "end", "when"), name, True


def _without_context(run: Run) -> Iterator[tuple[KeyPath, Any]]:
    """Yield the contents, with their places, of what holds or is sent in any context.

    These are conditions, and the steps to rest that a guard sends, too.
    """
    yield ("run", "abort_when"), run.abort_when
    if run.rest is not None:
        yield ("run", REST, "until"), run.rest.until
    for index, step in enumerate(run.after):
        if step.publish is None:
            return
        yield ("run", AFTER, index, "publish", "message"), step.publish.message


def _in_streams(run: Run) -> Iterator[tuple[KeyPath, Any]]:
    """Yield the contents of streams, with their places."""
    for path, step in run.steps:
        if step.publish is None or not step.publish.streams:
            continue
        for below, topic in zip(step.publish.paths, step.publish.published, strict=True):
            key_path = (*path, "publish", *below)
            yield (*key_path, "message"), topic.message
            for name, profile in topic.profile.items():
                yield (*key_path, "profile", name), profile.expression


def _names(step: Step) -> Iterator[tuple[KeyPath, str]]:
    """Yield the names in braces in a step, with their places below it."""
    for kind, key in _CONTENTS.items():
        if (spec := getattr(step, kind)) is not None:
            for name in names_in(getattr(spec, key)):
                yield (kind, key), name
    if step.wait_until is not None:
        for name in names_in(step.wait_until.condition):
            yield ("wait_until", "condition"), name
