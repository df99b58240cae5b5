"""The references between the parts of a study; a study checks them when it is made.

Each function raises `StudyError` with the key path in the study file, or within its argument.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any

from bo_tuner import maxima
from bo_tuner.codec import checks
from bo_tuner.codec.findings import Findings, under
from bo_tuner.errors import KeyPath, StudyError
from bo_tuner.numerics.signal_metrics import NEVER_NEGATIVE
from bo_tuner.study.braces import without_names
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.distance_metric import DistanceMetric
from bo_tuner.study.lag_metric import LagMetric
from bo_tuner.study.metric_scale import check_limits
from bo_tuner.study.metrics import (
    COMPUTED,
    RelativeMetric,
    ReportedMetric,
    SignalMetric,
    StudyMetric,
)
from bo_tuner.study.nodes import NodeSpec
from bo_tuner.study.parameter import Parameter, array_and_item
from bo_tuner.study.parts import (
    LINEAR,
    LOG,
    ContextVariable,
    Objective,
    SeedParameter,
    Trigger,
)
from bo_tuner.study.ranges import check_limit
from bo_tuner.study.run import Run
from bo_tuner.study.signals import Signal, only_numbers
from bo_tuner.study.step_values import check_braces


def check_objectives(
    objectives: Sequence[Objective], metrics: Mapping[str, StudyMetric | None]
) -> None:
    """Refuse objectives without a metric or its logarithm, too many, or two of one metric."""
    checks.reference(objectives[0].metric, "metric", metrics, "objective", "metric")
    if len(objectives) > maxima.OBJECTIVES:
        raise StudyError(
            f"expected at most {maxima.OBJECTIVES} objectives in all, found {len(objectives)}",
            ("further_objectives",),
        )
    taken = [objectives[0].metric]
    for index, item in enumerate(objectives[1:]):
        path = ("further_objectives", index, "metric")
        checks.reference(item.metric, "metric", metrics, *path)
        if item.metric in taken:
            raise StudyError(
                f"expected another metric, found '{item.metric}' again; each objective has a "
                "metric of its own",
                path,
            )
        taken.append(item.metric)
    for index, item in enumerate(objectives):
        if item.scale == LOG and isinstance(metrics[item.metric], RelativeMetric):
            where: KeyPath = ("further_objectives", index - 1) if index else ("objective",)
            raise StudyError(
                f"expected {LINEAR}; metric '{item.metric}' is relative to the default, and may be "
                "0 or negative",
                (*where, "scale"),
            )


def check_constraint(constraint: Constraint, metrics: Mapping[str, StudyMetric | None]) -> None:
    """Refuse a limit on a metric that is not there, and one that no run can keep.

    A metric that is None was refused itself; the limit is not compared with it.
    """
    checks.reference(constraint.metric, "metric", metrics, "metric")
    metric = metrics[constraint.metric]
    if metric is not None:
        check_limit(constraint, metric.range)
        check_limits(metric, constraint)
    # A distance is never negative, and neither is any measure of it.
    never_negative = isinstance(metric, DistanceMetric) or (
        isinstance(metric, SignalMetric) and metric.measure in NEVER_NEGATIVE
    )
    if (
        isinstance(metric, SignalMetric | DistanceMetric)
        and never_negative
        and constraint.upper is not None
        and constraint.upper < 0.0
    ):
        raise StudyError(
            f"no run keeps it: {metric.measure} is at least 0, found {constraint.upper:g}",
            ("upper",),
        )


def node_references(
    parts: Iterable[tuple[str, Mapping[str, object]]],
    trigger: Trigger | None,
    seed: SeedParameter | None,
) -> Iterator[tuple[KeyPath, str]]:
    """Yield the references to nodes in sections of parts by name: key path, and key of the node."""
    for section, items in parts:
        for name, item in items.items():
            if isinstance(item, Parameter | ContextVariable | ReportedMetric) and item.node:
                yield (section, name), item.node
    if trigger is not None:
        yield ("trigger",), trigger.node
    if seed is not None:
        yield ("seed_parameter",), seed.node


def check_signals(
    run: Run | None,
    metrics: Mapping[str, object],
    signals: Collection[str],
    nodes: Collection[str],
) -> None:
    """Refuse expressions with signals that are not there, in metrics and in a run."""
    findings = Findings()
    for name, metric in metrics.items():
        if isinstance(metric, SignalMetric | DistanceMetric | LagMetric):
            with findings.under("metrics", name):
                metric.check_signals(signals)
    if run is not None:
        with findings.under():
            run.check_references(signals, nodes)
    findings.check()


def check_kinds(
    run: Run | None, metrics: Mapping[str, object], signals: Mapping[str, Signal]
) -> None:
    """Refuse whole messages where numbers are needed, and numbers where whole messages are."""
    findings = Findings()
    for name, metric in metrics.items():
        if isinstance(metric, SignalMetric | DistanceMetric | LagMetric):
            with findings.under("metrics", name):
                metric.check_kinds(signals)
    for text, path in () if run is None else run.conditions:
        with findings.under():
            only_numbers(without_names(text), signals, *path)
    findings.check()


def check_run(
    trigger: Trigger | None,
    run: Run | None,
    metrics: Mapping[str, StudyMetric],
    signals: Mapping[str, Signal],
    nodes: Mapping[str, NodeSpec],
) -> None:
    """Refuse a run that does not give the metrics, or that is described twice."""
    if trigger is None and run is None:
        raise StudyError("missing; expected trigger, or run with signals", ("trigger",))
    if trigger is not None and run is not None:
        raise StudyError("a study has either trigger or run; leave one out", ("run",))
    reporting = {}
    for name, metric in metrics.items():
        key_path = ("metrics", name)
        if isinstance(metric, COMPUTED):
            continue
        if not isinstance(metric, ReportedMetric):
            if run is None:
                raise StudyError("signals are recorded in a run; add run", key_path)
        elif run is not None:
            raise StudyError(
                "is reported by a node that is triggered; with run, write of and measure",
                (*key_path, "node"),
            )
        else:
            reporting[metric.node] = f"metric '{name}'"
    if trigger is not None:
        reporting[trigger.node] = "the trigger"
    for node, needed_by in reporting.items():
        if not nodes[node].result:
            raise StudyError(f"missing; {needed_by} needs it", ("nodes", node, "result"))
    if run is None and signals:
        raise StudyError("signals are recorded in a run; add run", ("signals",))


def check_names(
    parts: Mapping[str, Any], names: Mapping[str, Collection[str]], findings: Findings
) -> None:
    """Refuse references to nothing in a study in which some parts were refused themselves.

    Parameters
    ----------
    parts
        The sections of the study, without the parts that were refused.
    names
        By section the names of all parts in the file, also of those that could not be made; a
        section that is none at all is left out, and so is what refers to it.
    findings
        Collects the errors.
    """
    named = {key: parts.get(key, {}) for key in ("parameters", "contexts", "metrics")}
    if "nodes" in names:
        references = node_references(
            named.items(), parts.get("trigger"), parts.get("seed_parameter")
        )
        for path, node in references:
            with findings.under():
                checks.reference(node, "node", names["nodes"], *path, "node")
    if {"signals", "nodes"} <= names.keys():
        with findings.under():
            check_signals(parts.get("run"), named["metrics"], names["signals"], names["nodes"])
    # A name may stand in a part that was refused itself.
    nodes = parts.get("nodes", {})
    has_all = nodes.keys() == set(names.get("nodes", ())) and ("run" in parts or "run" not in names)
    if {"contexts", "parameters"} <= names.keys() and has_all:
        with findings.under():
            check_braces(
                parts.get("run"),
                nodes,
                dict.fromkeys(names["contexts"]) | named["contexts"],
                dict.fromkeys(names["parameters"]) | named["parameters"],
            )
    if "metrics" not in names:
        return
    metrics = dict.fromkeys(names["metrics"]) | named["metrics"]
    if "objective" in parts:
        with findings.under():
            check_objectives((parts["objective"], *parts.get("further_objectives", ())), metrics)
    for name, constraint in parts.get("constraints", {}).items():
        with findings.under("constraints", name):
            check_constraint(constraint, metrics)


def check_targets(
    nodes: Mapping[str, NodeSpec],
    parameters: Mapping[str, Parameter],
    contexts: Mapping[str, ContextVariable],
    seed: SeedParameter | None,
) -> None:
    """Refuse two keys of one node, two sources for one parameter, and items of no array."""
    keys: dict[str, str] = {}
    for key, spec in nodes.items():
        if (other := keys.setdefault(spec.node, key)) != key:
            raise StudyError(f"'{spec.node}' is already nodes.{other}", ("nodes", key, "node"))
    sources: dict[tuple[str, str], str] = {}
    arrays = {(item.node, item.array) for item in parameters.values() if item.array}
    for name, item in parameters.items():
        if item.array:
            _check_item(name, item, nodes)
    for key, node in nodes.items():
        for name in (*node.parameters, *node.inprocess_parameters):
            _refuse_unwatched(node, name)
            if (key, name) not in arrays:
                sources[key, name] = f"nodes.{key}"
    targets: list[tuple[KeyPath, str, str]] = [
        ((section, name), item.node, item.parameter)
        for section, items in (("parameters", parameters), ("contexts", contexts))
        for name, item in items.items()
        if item.node
    ]
    if seed is not None:
        targets.append((("seed_parameter",), seed.node, seed.parameter))
    for path, node_key, parameter in targets:
        _refuse_unwatched(nodes[node_key], array_and_item(parameter)[0] or parameter)
        place = ".".join(map(str, path))
        other = sources.setdefault((node_key, parameter), place)
        if other != place:
            raise StudyError(
                f"parameter '{parameter}' of node '{node_key}' is already set by {other}", path
            )


def check_settings(
    run: Run,
    nodes: Mapping[str, NodeSpec],
    parameters: Mapping[str, Parameter],
    contexts: Mapping[str, ContextVariable],
    seed: SeedParameter | None,
) -> None:
    """Refuse steps that set parameters of nodes that are not there, or that the study varies."""
    varied = {
        (item.node, getattr(item, "array", "") or item.parameter): f"{section}.{name}"
        for section, items in (("parameters", parameters), ("contexts", contexts))
        for name, item in items.items()
    }
    if seed is not None:
        varied[seed.node, seed.parameter] = "seed_parameter"
    findings = Findings()
    for path, item in run.settings:
        with findings.under():
            checks.reference(item.node, "node", nodes, *path, "node")
            _refuse_unwatched(nodes[item.node], item.parameter)
            if other := varied.get((item.node, item.parameter)):
                raise StudyError(
                    f"'{item.parameter}' of node '{item.node}' is set by {other}; expected one "
                    "that the study does not vary",
                    (*path, "parameter"),
                )
    findings.check()


def _refuse_unwatched(spec: NodeSpec, parameter: str) -> None:
    """Refuse to set an unwatched parameter: nobody would notice that the node has another value."""
    if pattern := spec.unwatched_by(parameter):
        raise StudyError(
            f"'{pattern}' is also '{parameter}', which the study sets; what is set is watched",
            ("nodes", spec.name, "unwatched"),
        )


def _check_item(name: str, item: Parameter, nodes: Mapping[str, NodeSpec]) -> None:
    """Refuse an item of an array that the study does not have, or not with such an item."""
    path = ("nodes", item.node, "parameters", item.array)
    if item.array not in nodes[item.node].parameters:
        raise StudyError(f"missing; expected the array of which '{name}' is an item", path)
    array = nodes[item.node].parameters[item.array]
    if not isinstance(array, tuple):
        raise StudyError(f"expected an array, found {checks.show(array)}", path)
    if item.item >= len(array):
        raise StudyError(f"has {len(array)} items, so that there is no '{item.parameter}'", path)
    with under(*path, item.item):
        item.checked(array[item.item])
