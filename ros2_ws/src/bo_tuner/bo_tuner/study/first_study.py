"""A first study for running nodes that know nothing of the tuner, as a text with comments.

The parameters and signals that are chosen are written out, and the others as comments. Each guess
is marked `CHECK`.
"""

import re
import shlex
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import PurePath
from typing import Any

from bo_tuner.codec import checks
from bo_tuner.errors import StudyError
from bo_tuner.study.first_run import known, run_lines
from bo_tuner.study.offers import (
    CHECK,
    ParameterOffer,
    context_offers,
    is_seed,
    parameter_offers,
    reference_offers,
)
from bo_tuner.study.parameter import array_and_item, study_name
from bo_tuner.study.parameter_kinds import Kind
from bo_tuner.study.seen import Seen, SeenNode, SeenTopic
from bo_tuner.study.signal_offers import SignalOffer, is_truth, partner, reference, signal_offers
from bo_tuner.study.signals import Signal
from bo_tuner.study.sizing import OF_PARAMETER, first_budget
from bo_tuner.study.strict_yaml import dump_line
from bo_tuner.text import listed, one_line


def first_study(
    source: str,
    seen: Seen,
    nodes: Sequence[SeenNode],
    parameters: Sequence[ParameterOffer],
    signals: Sequence[SignalOffer],
    ros_arguments: Sequence[str] = (),
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
    ros_arguments
        ``--ros-args`` of the commands that follow.

    Returns
    -------
    str
        YAML that `bo_tuner.study.study_file.parse_study` reads.
    """
    tuned = [node for node in nodes if any(offer.node == node.name for offer in parameters)]
    keys = node_keys([*nodes, *seen.nodes])
    names = _signal_names(signals)
    own = {node.name for node in tuned}
    wanted = reference(signals, own)
    measured = _measured(signals, wanted, own)
    metrics = list(_metric_lines(names, wanted, measured, own))
    budget = first_budget(
        len(parameters),
        contexts=any(context_offers(node) for node in seen.nodes),
        limits_runs="# constraints:" in metrics,
    )
    lines = [
        *heading(source, "the nodes that were running", ("--attach",), ros_arguments),
        "",
        *_process_lines(seen, own),
        "nodes:",
        *(node_line(keys[node.name], node, parameters) for node in tuned),
        *(
            f"  # {keys[node.name]}: {dump_line({'node': node.name})}"
            for node in seen.nodes
            if node.name not in own and (node in nodes or context_offers(node))
        ),
        "",
        "# `check` tries which move a metric: a node may read some only while it starts.",
        "parameters:",
        *parameter_lines(nodes, parameters, keys),
        *_context_lines(seen.nodes, parameters, keys),
        *_seed_lines(nodes, keys),
        "",
        "signals:",
        *_signal_lines(seen.topics, names),
        "",
        *run_lines(
            seen,
            names,
            wanted,
            measured,
            [(keys[node.name], *offer) for node in tuned for offer in reference_offers(node)],
            is_simulated=any(node.uses_sim_time for node in tuned),
        ),
        "",
        *metrics,
        "",
        f"# {OF_PARAMETER} trials for each parameter, and {OF_PARAMETER} more.",
        f"budget: {dump_line(budget)}",
    ]
    return "\n".join(lines) + "\n"


def heading(
    source: str, origin: str, attach: Sequence[str], ros_arguments: Sequence[str]
) -> list[str]:
    """Return the first lines of a study in the file `source`, what it is made from and its name."""
    stem = PurePath(source).stem
    return [
        f"# A first study, written by `init` from {origin}.",
        f"# What it could not know is marked {CHECK}. Lines in comments are offers.",
        f"# Then: {command_line('check', source, *ros_arguments)}",
        f"#       {command_line('tune', '--study', source, *attach, *ros_arguments)}",
        f"name: {stem if checks.SIMPLE_NAME.fullmatch(stem) else 'first'}",
    ]


def command_line(*words: str) -> str:
    """Return a command as a line of a comment."""
    return one_line(shlex.join(words))


def _measured(
    signals: Sequence[SignalOffer], wanted: SignalOffer | None, tuned: Collection[str]
) -> SignalOffer | None:
    """Return the signal to judge: the one that follows the reference, or one that is no command."""
    if wanted is not None:
        return partner(wanted, signals, tuned)
    possible = [offer for offer in signals if offer.topic.publishers] or list(signals)
    of_others = [offer for offer in possible if not set(offer.topic.publishers) & set(tuned)]
    return next(iter(of_others or possible))


def _process_lines(seen: Seen, tuned: Collection[str]) -> Iterator[str]:
    """Yield a line on each process with a tuned node and others."""
    for names in seen.together:
        if set(tuned) & set(names):
            yield f"# {one_line(listed(names))} run in one process: what starts one starts all."


def node_line(key: str, node: SeenNode, parameters: Iterable[ParameterOffer]) -> str:
    """Return the entry of a node that is tuned."""
    line = f"  {key}: {dump_line(_node_fields(node, parameters))}"
    return f"{line}  # {CHECK}: unwatched has changed by itself" if node.changing else line


def _node_fields(node: SeenNode, parameters: Iterable[ParameterOffer]) -> dict[str, Any]:
    """Return a node's entry, with the arrays that have a tuned item."""
    arrays = {array_and_item(offer.name)[0] for offer in parameters if offer.node == node.name}
    values = {
        name: list(seen.value)
        for name, seen in node.parameters.items()
        if name in arrays and isinstance(seen.value, (list, tuple))
    }
    fields: dict[str, Any] = {"node": node.name}
    if node.command:
        fields |= {"command": node.command, "at_start": True}
    if values:
        fields["parameters"] = values
    if node.changing:
        fields["unwatched"] = list(node.changing)
    return fields


def node_keys(nodes: Iterable[SeenNode]) -> dict[str, str]:
    """Return the keys of nodes in the study: the last part of the name where that is clear."""
    names = list(dict.fromkeys(node.name for node in nodes))
    last = [name.rpartition("/")[2] for name in names]
    return {
        name: short if last.count(short) == 1 else name.replace("/", "_")
        for name, short in zip(names, last, strict=True)
    }


def parameter_lines(
    nodes: Sequence[SeenNode],
    taken: Sequence[ParameterOffer],
    keys: Mapping[str, str],
    tied: Mapping[ParameterOffer, ParameterOffer] | None = None,
) -> Iterator[str]:
    """Yield the parameters that are taken, those that are tied to another one, and offers."""
    tied = tied or {}
    names = [study_name(offer.name) for offer in taken]

    def name_of(offer: ParameterOffer) -> str:
        name = study_name(offer.name)
        return f"{keys[offer.node]}.{name}" if names.count(name) > (offer in taken) else name

    for node in nodes:
        offers, others = parameter_offers(node)
        possible = [offer for offer in offers if offer in taken or offer.kind is not Kind.PLANT]
        # First the parameters that are taken, last those that are hardly for tuning.
        for offer in sorted(possible, key=lambda o: 0 if o in taken else 2 - o.suggested):
            name = name_of(offer)
            own = offer.fields
            if offer in tied:
                own = {"type": "double", "tied_to": name_of(tied[offer])}
            fields: dict[str, Any] = {"node": keys[node.name], **own}
            if name != offer.name:
                fields["parameter"] = offer.name
            remark = f"  # {offer.remark}" if offer.remark else ""
            mark = "" if offer in taken else "# "
            yield f"  {mark}{dump_line(name)}: {dump_line(fields)}{remark}"
        for name, why in others.items():
            yield f"  # {one_line(name)} of {keys[node.name]}: {one_line(why)}"


def _context_lines(
    nodes: Iterable[SeenNode], taken: Sequence[ParameterOffer], keys: Mapping[str, str]
) -> Iterator[str]:
    """Yield the properties of a plant as offers."""
    names = [study_name(offer.name) for offer in taken]
    lines = []
    for node in nodes:
        for offer in context_offers(node):
            if any((other.node, other.name) == (node.name, offer.name) for other in taken):
                continue
            fields, name = {"node": keys[node.name], **offer.fields}, study_name(offer.name)
            if name in names:
                name = f"{keys[node.name]}.{name}"
            if name != offer.name:
                fields["parameter"] = offer.name
            names.append(name)
            lines.append(f"#   {dump_line(name)}: {dump_line(fields)}  # {offer.remark}")
    if lines:
        yield ""
        yield f"# {CHECK}: properties of the plant by their names; which differ in operation,"
        yield "# and by how much? They are set before each run, so a simulation has to have them."
        yield "# contexts:"
        yield from lines


def _seed_lines(nodes: Sequence[SeenNode], keys: Mapping[str, str]) -> Iterator[str]:
    for node in nodes:
        for name, described in node.parameters.items():
            if is_seed(name, described) and not described.read_only:
                fields = {"node": keys[node.name], "parameter": name}
                yield ""
                yield f"# {CHECK}: if it seeds the noise, each run gets a seed of its own."
                yield f"# seed_parameter: {dump_line(fields)}"


def _signal_names(signals: Iterable[SignalOffer]) -> dict[SignalOffer, str]:
    """Name signals: a field by its last words, and `data` by its topic."""
    names: dict[SignalOffer, str] = {}
    signals = list(signals)
    shorts = [_short_name(offer) for offer in signals]
    for offer, short in zip(signals, shorts, strict=True):
        topic = _words(offer.topic.name)
        last = _words(offer.topic.name.rpartition("/")[2])
        candidates = [short, f"{last}_{short}", f"{topic}_{_words(offer.field)}"]
        # If two names are the same, both get their topic.
        candidates = candidates[shorts.count(short) > 1 and offer.field != "data" :]
        candidates += [f"signal_{i}" for i in range(len(names) + 1)]
        names[offer] = next(
            name for name in candidates if name not in names.values() and _is_signal(name, offer)
        )
    return names


def _short_name(offer: SignalOffer) -> str:
    last = offer.topic.name.rpartition("/")[2]
    if offer.joint:
        return _words(f"{last}_{offer.joint}")
    if offer.field == "data":
        return _words(last)
    if offer.field.endswith(")"):
        return _words(offer.field)
    # Such as linear.x for twist.twist.linear.x: one letter alone says too little.
    return _words(".".join(offer.field.split(".")[-2:]))


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
        if len(offer.topic.nodes) > 1:
            fields["publisher"] = offer.topic.nodes[0]
        yield f"  {name}: {dump_line(fields)}  # {offer.topic.type}, {offer.remark}"
    for topic in topics:
        left = [offer.field for offer in signal_offers(topic) if offer not in names]
        if left:
            shown = ", ".join(one_line(name) for name in left)
            yield f"  # {topic.name} ({topic.type}): {shown}"


def _metric_lines(
    names: Mapping[SignalOffer, str],
    wanted: SignalOffer | None,
    measured: SignalOffer | None,
    tuned: Collection[str],
) -> Iterator[str]:
    outputs = [
        offer
        for offer in names
        if set(offer.topic.publishers) & set(tuned) and offer not in (wanted, measured)
    ]
    constraints = []
    if wanted is not None and measured is not None:
        name, target = names[measured], names[wanted]
        if wanted.topic.publishers:
            yield f"# {known(wanted.topic)}"
        follows = "estimates" if is_truth(wanted) else "is to follow"
        yield f"metrics:  # {CHECK}: what good means, and whether {name} {follows} {target}"
        measure = "rms" if is_truth(wanted) else "iae"
        yield f"  error: {dump_line({'of': f'{target} - {name}', 'measure': measure})}"
        if not is_truth(wanted):
            overshoot = {"of": name, "measure": "overshoot", "target": target, "unit": "%"}
            yield f"  overshoot: {dump_line(overshoot)}"
            constraints.append(("overshoot", 5.0))
    else:
        name = names[measured] if measured is not None else next(iter(names.values()))
        yield f"metrics:  # {CHECK}: what good means"
        yield f"  # Subtract what {name} shall be: {{of: 1.5 - {name}, measure: iae}}."
        yield f"  error: {dump_line({'of': name, 'measure': 'rms'})}"
    if outputs:
        effort = {"of": names[outputs[0]], "measure": "total_variation"}
        yield f"  effort: {dump_line(effort)}"
        constraints.append(("effort", 10.0))
    yield ""
    yield "objective: {metric: error}"
    if constraints:
        yield f"# {CHECK}: limits; `check` shows what the present parameters reach."
        yield "# constraints:"
    for metric, upper in constraints:
        fields = {"kind": "chance", "metric": metric, "upper": upper, "probability": 0.9}
        yield f"#   {metric}: {dump_line(fields)}"
