"""What is said of tuned parameters that were not seen to move any metric, on every screen."""

from collections.abc import Iterable, Sequence
from math import isinf

from bo_tuner.study.study import Study
from bo_tuner.text import listed, shown
from bo_tuner.tuning.effects import FAILURES, Effect, ParameterEffects

NAMED = 3
"""Largest number of metrics that are named beside a parameter; the summary has all."""


def not_seen(study: Study, item: ParameterEffects) -> str:
    """Return what to know of a parameter that was not seen to move any metric."""
    title = study.parameters[item.parameter].title_and_name
    return f"{title} was not seen to move any metric ({_visible(study, item.effects)})"


def title_of(study: Study, effect: Effect) -> str:
    """Return what screens call that which moves: a metric, or the share of failures."""
    return effect.metric if effect.metric == FAILURES else study.metrics[effect.metric].title


def effects_in_words(study: Study, parameters: Sequence[ParameterEffects]) -> tuple[str, ...]:
    """Return sentences on the parameters that a run has not seen to move any metric."""
    sentences = [f"{not_seen(study, item)}." for item in parameters if item.unseen]
    sentences += proposals(study, parameters)
    if open_ := [
        study.parameters[item.parameter].title
        for item in parameters
        if not item.seen and not item.conclusive
    ]:
        verb = "moves" if len(open_) == 1 else "move"
        sentences.append(f"The trials are too few to tell whether {listed(open_)} {verb} a metric.")
    return tuple(sentences)


def proposals(study: Study, parameters: Sequence[ParameterEffects]) -> list[str]:
    """Return what to do about parameters that do nothing, a sentence for each node."""
    unseen: dict[str, list[str]] = {}
    seen: dict[str, list[str]] = {}
    for item in parameters:
        of_kind = unseen if item.unseen else seen if item.seen else {}
        of_kind.setdefault(study.parameters[item.parameter].node, []).append(item.parameter)
    return [_proposal(study, key, names, seen.get(key, [])) for key, names in unseen.items()]


def file_notes(study: Study, parameters: Iterable[ParameterEffects]) -> tuple[str, ...]:
    """Return what a file of parameters is to say of its values, a line each."""
    return tuple(
        f"{item.parameter}{_of_node(study, item.parameter)}: not seen to move any metric "
        f"({_visible(study, item.effects)})"
        for item in parameters
        if item.unseen
    )


def amount(size: float, effect: Effect) -> str:
    """Return a size of an effect with its unit."""
    if effect.metric == FAILURES:
        return f"{100.0 * size:.3g} %"
    return f"{shown(size)} {effect.unit}".rstrip()


def _visible(study: Study, effects: Sequence[Effect]) -> str:
    """Return which effects would have been seen."""
    metrics = [e for e in effects if e.metric != FAILURES and not isinf(e.visible)]
    noisy = [
        f"above {amount(float(f'{e.visible:.2g}'), e)} on {title_of(study, e)}"
        for e in metrics
        if e.visible
    ]
    if noisy:
        return f"an effect {listed(noisy[:NAMED])} would have been seen"
    exact = [title_of(study, e) for e in metrics]
    return f"any effect on {listed(exact[:NAMED])} would have been seen"


def _proposal(study: Study, key: str, names: Sequence[str], seen: Sequence[str]) -> str:
    """Return what may be the matter with parameters of a node, others of which were seen to act."""
    them = "it" if len(names) == 1 else "them"
    if not key:
        return f"The runs do not depend on {listed(names)}: leave {them} fixed."
    node = study.nodes[key].node
    if all(_is_set_at_start(study, name) for name in names):
        return (
            f"{node} is started with {listed(names)} (at_start), so it may ignore what it is "
            f"started with, or the runs do not depend on {them}: leave {them} fixed."
        )
    live = [name for name in seen if not _is_set_at_start(study, name)]
    if live:
        return (
            f"{node} takes other values while it runs, as {listed(live[:NAMED])} moved a metric: "
            f"the runs do not depend on {listed(names)}, so leave {them} fixed."
        )
    return (
        f"{node} may read {listed(names)} only while it starts: with at_start: true under "
        f"nodes.{key} the tuner starts it with the values of each trial. Otherwise the runs do not "
        f"depend on {them}: leave {them} fixed."
    )


def _of_node(study: Study, name: str) -> str:
    """Return whose a parameter is; empty for one that stands only in steps."""
    key = study.parameters[name].node
    return f" of {study.nodes[key].node}" if key else ""


def _is_set_at_start(study: Study, name: str) -> bool:
    """Return whether the tuner starts the node of a parameter with its value."""
    item = study.parameters[name]
    return item.parameter in study.start_names.get(item.node, ())
