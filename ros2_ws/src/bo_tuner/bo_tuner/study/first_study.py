"""A first study for running nodes that know nothing of the tuner, as a text with comments.

What is chosen of their offers is written out, and the rest as comments. Nothing is invented
silently: each guess is marked `CHECK`.
"""

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import PurePath
from typing import Any

from bo_tuner.errors import StudyError
from bo_tuner.study import checks
from bo_tuner.study.offers import (
    CHECK,
    ParameterOffer,
    Seen,
    SeenAction,
    SeenNode,
    SeenTopic,
    SignalOffer,
    is_seed,
    parameter_offers,
    signal_offers,
)
from bo_tuner.study.parameter import array_and_item
from bo_tuner.study.signals import Signal
from bo_tuner.study.strict_yaml import dump_line
from bo_tuner.text import one_line

WANTED = re.compile(r"set_?point|reference|target|desired|wanted|goal", re.IGNORECASE)
"""In the name of a topic: it carries what another signal shall follow."""
SECONDS = 2.0
"""Of a run, until somebody says better."""


def first_study(
    source: str,
    seen: Seen,
    nodes: Sequence[SeenNode],
    parameters: Sequence[ParameterOffer],
    signals: Sequence[SignalOffer],
) -> str:
    """Write a study.

    Parameters
    ----------
    source
        Name of its file.
    seen
        All that runs; what is not taken is offered in comments.
    nodes
        Those to tune; of these only the ones with a parameter that is taken are written.
    parameters, signals
        Those to take, at least one each.

    Returns
    -------
    str
        YAML that `bo_tuner.study.study_file.parse_study` reads.
    """
    stem = PurePath(source).stem
    tuned = [node for node in nodes if any(offer.node == node.name for offer in parameters)]
    keys = _node_keys([node.name for node in nodes])
    names = _signal_names(signals)
    wanted = next((s for s in signals if not s.topic.publishers), None) or next(
        (s for s in signals if WANTED.search(s.topic.name)), None
    )
    lines = [
        "# A first study, written by `tune --init` from the nodes that were running.",
        f"# What it could not know is marked {CHECK}. Lines in comments are offers.",
        f"# Then: tune --check {source}",
        f"#       tune --study {source} --attach",
        f"name: {stem if checks.SIMPLE_NAME.fullmatch(stem) else 'first'}",
        "",
        "nodes:",
        *(f"  {keys[node.name]}: {dump_line(_node_fields(node, parameters))}" for node in tuned),
        *(
            f"  # {keys[node.name]}: {dump_line({'node': node.name})}"
            for node in nodes
            if node not in tuned
        ),
        "",
        "parameters:",
        *_parameter_lines(nodes, parameters, keys),
        *_seed_lines(nodes, keys),
        "",
        "signals:",
        *_signal_lines(seen.topics, names),
        "",
        *_run_lines(seen, tuned, names, wanted),
        "",
        *_metric_lines(names, wanted, {node.name for node in tuned}),
        "",
        "budget: {trials: 20, initial_trials: 8, drawn_contexts: 1, validation_draws: 5}",
    ]
    return "\n".join(lines) + "\n"


def _node_fields(node: SeenNode, parameters: Iterable[ParameterOffer]) -> dict[str, Any]:
    """Return a node's entry; it has the arrays of whose items some are tuned."""
    arrays = {array_and_item(offer.name)[0] for offer in parameters if offer.node == node.name}
    values = {
        name: list(seen.value)
        for name, seen in node.parameters.items()
        if name in arrays and isinstance(seen.value, (list, tuple))
    }
    return {"node": node.name} | ({"parameters": values} if values else {})


def _node_keys(names: Sequence[str]) -> dict[str, str]:
    """Return the keys of nodes in the study: the last part of the name where that is clear."""
    last = [name.rpartition("/")[2] for name in names]
    return {
        name: short if last.count(short) == 1 else name.replace("/", "_")
        for name, short in zip(names, last, strict=True)
    }


def _parameter_lines(
    nodes: Sequence[SeenNode], taken: Sequence[ParameterOffer], keys: Mapping[str, str]
) -> Iterator[str]:
    names = [offer.name for offer in taken]
    for node in nodes:
        offers, others = parameter_offers(node)
        # Those that are taken first.
        for offer in sorted(offers, key=lambda offer: offer not in taken):
            key = keys[node.name]
            fields: dict[str, Any] = {"node": key, **offer.fields}
            name = offer.name
            if names.count(name) > (offer in taken):
                name = f"{key}.{name}"
                fields["parameter"] = offer.name
            remark = f"  # {offer.remark}" if offer.remark else ""
            mark = "" if offer in taken else "# "
            yield f"  {mark}{dump_line(name)}: {dump_line(fields)}{remark}"
        for name, why in others.items():
            yield f"  # {one_line(name)} of {keys[node.name]}: {one_line(why)}"


def _seed_lines(nodes: Sequence[SeenNode], keys: Mapping[str, str]) -> Iterator[str]:
    for node in nodes:
        for name, described in node.parameters.items():
            if is_seed(name, described) and not described.read_only:
                fields = {"node": keys[node.name], "parameter": name}
                yield ""
                yield f"# {CHECK}: if it seeds the noise, each run gets a seed of its own."
                yield f"# seed_parameter: {dump_line(fields)}"


def _signal_names(signals: Iterable[SignalOffer]) -> dict[SignalOffer, str]:
    """Name signals: a field by its own words, and `data` by its topic."""
    names: dict[SignalOffer, str] = {}
    for offer in signals:
        topic = _words(offer.topic.name)
        last = offer.topic.name.rpartition("/")[2]
        short = _words(last if offer.field == "data" else offer.field)
        candidates = [short, f"{topic}_{short}", *(f"signal_{i}" for i in range(len(names) + 1))]
        names[offer] = next(
            name for name in candidates if name not in names.values() and _is_signal(name, offer)
        )
    return names


def _words(text: str) -> str:
    return re.sub(r"\W+", "_", text, flags=re.ASCII).strip("_")


def _is_signal(name: str, offer: SignalOffer) -> bool:
    try:
        Signal(name=name, topic=offer.topic.name, field=offer.field)
    except StudyError:
        return False
    return True


def _signal_lines(topics: Iterable[SeenTopic], names: Mapping[SignalOffer, str]) -> Iterator[str]:
    for offer, name in names.items():
        fields = {"topic": offer.topic.name, "field": offer.field}
        yield f"  {name}: {dump_line(fields)}  # {offer.topic.type}, {offer.remark}"
    for topic in topics:
        left = [offer.field for offer in signal_offers(topic) if offer not in names]
        if left:
            shown = ", ".join(one_line(name) for name in left)
            yield f"  # {topic.name} ({topic.type}): {shown}"


def _run_lines(
    seen: Seen,
    nodes: Sequence[SeenNode],
    names: Mapping[SignalOffer, str],
    wanted: SignalOffer | None,
) -> Iterator[str]:
    own = list({offer.topic.name: offer for offer in names if not offer.topic.publishers}.values())
    yield "run:"
    yield f"  # {CHECK}: what brings the system to where every run starts."
    if own:
        yield "  before:"
        for offer in own:
            yield f"    - publish: {dump_line(_message(offer, 0.0))}"
    else:
        yield "  # before:"
    for service in seen.services:
        yield f"{'    # ' if own else '  #   '}- call: {dump_line({'service': service})}"
    yield f"{'    ' if own else '  #   '}- wait: 0.5"
    if wanted is not None and not wanted.topic.publishers:
        yield f"  start:  # {CHECK}: this moves the machine."
        yield f"    - publish: {dump_line(_message(wanted, 1.0))}"
        yield from (f"    # {line}" for line in _goals(seen.actions))
    else:
        yield f"  # {CHECK}: what sets it in motion; without it a run only watches."
        silent = [topic for topic in seen.topics if not topic.publishers and topic.fields]
        offers = [SignalOffer(topic, next(iter(topic.fields))) for topic in silent[:1]]
        known = offers or seen.actions
        yield f"  # start:{'' if known else '  # docs/procedure.md lists the steps'}"
        yield from (f"  #   - publish: {dump_line(_message(offer, 1.0))}" for offer in offers)
        yield from (f"  #   {line}" for line in _goals(seen.actions))
    until = ", or result: until a goal of start is done" if seen.actions else ""
    yield f"  end: {{after: {SECONDS}}}  # {CHECK}: [s]{until}"
    if any(node.uses_sim_time for node in nodes):
        yield f"  clock: sim  # {CHECK}: the nodes use simulated time; its seconds are those of end"
    measured = next((name for offer, name in names.items() if offer != wanted), None)
    if measured is not None:
        yield f"  # abort_when: abs({measured}) > 2  # ends a bad run at once"


def _goals(actions: Iterable[SeenAction]) -> Iterator[str]:
    for action in actions:
        fields = ", ".join(f"{name} ({kind})" for name, kind in action.fields.items())
        step = dump_line({"action": action.name, "goal": {}})
        yield f"- send_goal: {step}  # {action.type}: {fields or 'no fields'}"


def _message(offer: SignalOffer, value: float) -> dict[str, Any]:
    """Return a step's topic and message, in which one field has a value."""
    fields = offer.topic.fields
    # As the message has it: an integer takes no 1.0, and a truth value no number.
    kind = type(fields[offer.field])
    nested: Any = kind(value)
    path, is_item, _ = offer.field.partition("[")
    if is_item:
        items = [name for name in fields if name.startswith(f"{path}[")]
        nested = [kind(value if name == offer.field else 0) for name in items]
    for part in reversed(path.split(".")):
        nested = {part: nested}
    return {"topic": offer.topic.name, "message": nested}


def _metric_lines(
    names: Mapping[SignalOffer, str], wanted: SignalOffer | None, tuned: Collection[str]
) -> Iterator[str]:
    followers = [offer for offer in names if wanted is None or offer.topic != wanted.topic]
    outputs = [offer for offer in followers if set(offer.topic.publishers) & set(tuned)]
    measured = next(
        (offer for offer in followers if offer not in outputs),
        followers[0] if followers else next(iter(names)),
    )
    constraints = []
    name = names[measured]
    yield f"metrics:  # {CHECK}: what good means"
    if wanted is not None and measured != wanted:
        target = names[wanted]
        yield f"  error: {dump_line({'of': f'{target} - {name}', 'measure': 'iae'})}"
        overshoot = {"of": name, "measure": "overshoot", "target": target, "unit": "%"}
        yield f"  overshoot: {dump_line(overshoot)}"
        constraints.append(("overshoot", 5.0))
    else:
        yield f"  # Subtract what {name} shall be: {{of: 1.5 - {name}, measure: iae}}."
        yield f"  error: {dump_line({'of': name, 'measure': 'rms'})}"
    if outputs:
        effort = {"of": names[outputs[0]], "measure": "total_variation"}
        yield f"  effort: {dump_line(effort)}"
        constraints.append(("effort", 10.0))
    yield ""
    yield "objective: {metric: error}"
    if constraints:
        yield f"# {CHECK}: limits; `tune --check` shows what the present parameters reach."
        yield "# constraints:"
    for metric, upper in constraints:
        fields = {"kind": "chance", "metric": metric, "upper": upper, "probability": 0.9}
        yield f"#   {metric}: {dump_line(fields)}"
