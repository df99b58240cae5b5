"""A study: the nodes, parameters, contexts, objective, constraints and budget of a tuning run."""

import dataclasses
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from bo_tuner import maxima
from bo_tuner.codec import checks
from bo_tuner.codec.findings import Findings, under
from bo_tuner.codec.reading import check_fields
from bo_tuner.codec.rules import Expected, Matching, OneOf, Whole, Written
from bo_tuner.errors import KeyPath, ParameterError, StudyError
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.at_start import start_names
from bo_tuner.study.braces import filled_text
from bo_tuner.study.budget import Budget, CertificateRequirement
from bo_tuner.study.configuring import check_parked, configured_by_steps
from bo_tuner.study.constraint import MODEL_NAMES, OBJECTIVE, OUTLIERS, Constraint
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.study.growing import check_cut_short, decisive, why_not
from bo_tuner.study.guarding import Guarding
from bo_tuner.study.limit_kinds.limited import LOWER, UPPER
from bo_tuner.study.measured import Measured, check_measured
from bo_tuner.study.metric_scale import check_scales
from bo_tuner.study.metrics import (
    COMPUTED,
    CombinedMetric,
    MetricOfStudy,
    PythonMetric,
    RelativeMetric,
    StudyMetric,
)
from bo_tuner.study.nodes import NodeSpec
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.park import Park
from bo_tuner.study.parts import (
    INTEGER,
    LOG,
    NONE,
    RANDOM,
    ContextVariable,
    Objective,
    SeedParameter,
    Trigger,
)
from bo_tuner.study.ranges import check_free
from bo_tuner.study.references import (
    check_constraint,
    check_kinds,
    check_objectives,
    check_run,
    check_settings,
    check_signals,
    check_targets,
    node_references,
)
from bo_tuner.study.run import Run
from bo_tuner.study.safe_search import SafeSearch
from bo_tuner.study.search_space import SearchSpace, search_space
from bo_tuner.study.signals import Signal
from bo_tuner.study.step_values import check_braces
from bo_tuner.study.steps import SetParameter, Step
from bo_tuner.study.straight_lines import broken_on_lines
from bo_tuner.study.titles import check_titles
from bo_tuner.text import counted
from bo_tuner.trials import Context, Value

DEFAULT_SET = "default"
"""Name of the default among the parameter sets that are tried first."""

MOST = {
    "nodes": maxima.NODES,
    "parameters": maxima.PARAMETERS,
    "contexts": maxima.CONTEXTS,
    "measured": maxima.CONTEXTS,
    "signals": maxima.SIGNALS,
    "metrics": maxima.METRICS,
    "constraints": maxima.CONSTRAINTS,
    "order": maxima.PARAMETERS,
    "where": maxima.CONDITIONS,
    "start": maxima.TRIALS,
}


BY_NAME = Expected("a mapping of names, {} for none")
PAIR = "[smaller, larger], two names of parameters"
SETS = f"parameter sets, or {DEFAULT_SET}"


GivenSet = Mapping[str, checks.ParameterValue]
"""Values of parameters as a file has them: a list need not be text."""


def _set(given: GivenSet | str) -> GivenSet | str:
    if isinstance(given, str) and given != DEFAULT_SET:
        raise StudyError(f"expected {SETS}, found {checks.show(given)}")
    return given


ParameterSet = Annotated[GivenSet | str, Expected(SETS), _set]


def _without_null(value: object) -> str:
    if "\0" in (text := checks.text(value)):
        raise StudyError("expected text without null characters")
    return text


@dataclass(frozen=True, kw_only=True)
class Study:
    """A checked study; the fields are the sections of the study file.

    Attributes
    ----------
    name : str
        Short name; the run folder is named after it.
    nodes : mapping from str to NodeSpec
        Nodes that take parameters or report metrics.
    parameters : mapping from str to Parameter
        Tuned, tied and fixed parameters.
    metrics : mapping from str to StudyMetric
        Results of an evaluation.
    objective : Objective
        What is optimized. Text is minimized: the name of a metric, or an expression of metrics as
        `error + 0.01 * effort`, which is then the metric `cost`.
    budget : Budget
        Number of trials and evaluations.
    trigger : Trigger, optional
        Starts an evaluation of nodes that report their own metrics; a study has either this or
        `run`.
    run : Run, optional
        The procedure of one evaluation, of nodes that have no interface to the tuner.
    signals : mapping from str to Signal
        What is recorded in such a run.
    park : Park
        What the nodes are set to while no run is performed.
    guard : Guarding
        Whether a guard watches also over nodes that the tuner starts, and its patience; or
        ``true``.
    safe_search : SafeSearch, optional
        The search tries only parameter sets that it expects to keep all limits; or ``true``.
    further_objectives : tuple of Objective
        One or two more objectives. The run then searches the Pareto front of all, and its result is
        a compromise.
    contexts : mapping from str to ContextVariable
        What varies from evaluation to evaluation; may be empty.
    measured : tuple of str
        Metrics that describe the surroundings of a run, such as its mean wind: contexts that nobody
        sets.
    constraints : mapping from str to Constraint
        Limits on metrics. One with two limits becomes two constraints.
    certificate : CertificateRequirement
        What a certificate must have for `apply`, at least.
    order : tuple of (str, str)
        Names (a, b) of parameters with a <= b.
    where : tuple of str
        Conditions that every parameter set satisfies, such as `ki <= kp / 2`.
    start : tuple of mapping or str
        Parameter sets that are tried first: ``default``, or values of parameters by name, where
        those that are left out are the defaults. Without this key, only the default.
    seed_parameter : SeedParameter, optional
        The node parameter that takes the seed of an evaluation's noise.
    noise : str
        `random`, or `none` of a simulator without noise, of which one run in a context decides
        whether a limit is kept there. Runs that contradict it are a fault.
    seed : int
        Seed of everything random in a run.
    description : str
        Free text.
    folder : str
        Where `command` and `launch` of a node are carried out, and where files of references and
        modules of Python functions and objects lie. Relative to the study file; its own folder
        unless given.

    Raises
    ------
    StudyError
        If a rule is violated; its path is the key path in the study file.
    """

    name: Annotated[str, Matching(checks.SIMPLE_NAME, "a name of letters, digits, _ and -")]
    nodes: Annotated[Mapping[str, NodeSpec], BY_NAME]
    parameters: Annotated[Mapping[str, Parameter], BY_NAME]
    metrics: Annotated[Mapping[str, MetricOfStudy], BY_NAME]
    objective: Annotated[Objective, Written(str)]
    budget: Budget
    trigger: Trigger | None = None
    run: Run | None = None
    signals: Annotated[Mapping[str, Signal], BY_NAME] = field(default_factory=dict)
    park: Park = field(default_factory=Park)
    guard: Guarding = field(default_factory=Guarding)
    safe_search: SafeSearch | None = None
    further_objectives: Annotated[tuple[Objective, ...], Expected("a list of objectives")] = ()
    contexts: Annotated[Mapping[str, ContextVariable], BY_NAME] = field(default_factory=dict)
    measured: Measured = ()
    constraints: Annotated[Mapping[str, Constraint], BY_NAME] = field(default_factory=dict)
    certificate: CertificateRequirement = field(default_factory=CertificateRequirement)
    order: Annotated[
        tuple[Annotated[tuple[str, str], Expected(PAIR)], ...], Expected(f"a list of {PAIR}")
    ] = ()
    where: Annotated[tuple[str, ...], Expected("a list of conditions such as ki <= kp / 2")] = ()
    start: Annotated[tuple[ParameterSet, ...], Expected(f"a list of {SETS}")] = (DEFAULT_SET,)
    seed_parameter: SeedParameter | None = None
    noise: Annotated[str, OneOf((RANDOM, NONE))] = RANDOM
    seed: Annotated[int, Whole(0)] = 1
    description: str = ""
    folder: Annotated[str, _without_null] = ""

    def __post_init__(self) -> None:
        """Check the references between the parts."""
        findings = Findings()
        # One with two limits is two constraints from here on.
        in_file = {
            f"{name}_{side}": name
            for name, item in self.constraints.items()
            if item.upper is not None and item.lower is not None
            for side in (LOWER, UPPER)
        }
        self._check_fields(findings)
        self._check_sizes(findings)
        object.__setattr__(self, "metrics", _joined(self.metrics, findings))
        parts = ((key, getattr(self, key)) for key in ("parameters", "contexts", "metrics"))
        has_nodes = True
        for path, node in node_references(parts, self.trigger, self.seed_parameter):
            has_nodes = has_nodes and node in self.nodes
            with findings.under():
                checks.reference(node, "node", self.nodes, *path, "node")
        if self.run is not None:
            with findings.under():
                check_signals(self.run, self.metrics, self.signals, self.nodes)
                check_kinds(self.run, self.metrics, self.signals)
        with findings.under():
            check_braces(self.run, self.nodes, self.contexts, self.parameters)
        # Other references are checked by way of the nodes.
        if has_nodes:
            with findings.under():
                check_run(self.trigger, self.run, self.metrics, self.signals, self.nodes)
            with findings.under():
                check_targets(self.nodes, self.parameters, self.contexts, self.seed_parameter)
            with findings.under():
                _ = self.start_names
            if self.run is not None:
                varied = (self.parameters, self.contexts, self.seed_parameter)
                with findings.under():
                    check_settings(self.run, self.nodes, *varied)
        with findings.under():
            check_objectives(self.objectives, self.metrics)
        for name, constraint in self.constraints.items():
            with findings.under("constraints", in_file.get(name, name)):
                check_constraint(constraint, self.metrics)
        for section in ("parameters", "metrics"):
            with findings.under(section):
                check_titles(getattr(self, section))
        with findings.under("metrics"):
            check_scales(self.metrics, self.constraints.values())
        if self.certificate.distribution_free:
            with findings.under():
                ranges = {name: metric.range for name, metric in self.metrics.items() if metric}
                check_free(self.constraints.values(), ranges)
        with findings.under():
            check_measured(
                self.measured, self.metrics, self.contexts, self.objectives, self.constraints
            )
        if self.budget.cut_short:
            with findings.under("budget", "cut_short"):
                limits = self.constraints.values()
                check_cut_short(self.metrics, limits, self.objectives, self.measured)
        if has_nodes:
            with findings.under():
                self._check_sets(findings)
        findings.check()

    def _check_fields(self, findings: Findings) -> None:
        """Check the fields that are no references; one with an error becomes its default."""
        check_fields(self, findings)
        each = (OBJECTIVE, OUTLIERS)
        taken = {f"{model}_{o.metric}" for o in self.further_objectives for model in each}
        with findings.under():
            constraints = _one_limit_each(self.constraints, {*MODEL_NAMES, *taken})
            object.__setattr__(self, "constraints", constraints)
        for section in ("nodes", "parameters", "metrics"):
            if not getattr(self, section):
                with findings.under():
                    raise StudyError("expected at least one", (section,))
        for section in ("nodes", "parameters", "signals", "contexts", "metrics"):
            for name, item in getattr(self, section).items():
                if item.name != name:
                    with findings.under():
                        raise StudyError(f"is called '{item.name}' in itself", (section, name))

    def _check_sizes(self, findings: Findings) -> None:
        """Refuse a study that is too large to be checked further, with the errors so far."""
        size = len(findings)
        for section, most in MOST.items():
            with findings.under():
                checks.at_most(getattr(self, section), most, section)
        with findings.under():
            if (count := len(self.tuned_names)) > maxima.TUNED:
                raise StudyError(
                    f"expected at most {maxima.TUNED} tuned ones, found {count}",
                    ("parameters",),
                )
        if len(findings) > size:
            findings.check()

    def _check_sets(self, findings: Findings) -> None:
        """Check the parameter sets of a study without errors in its parameters."""
        self.search_space()
        with findings.under():
            self._check_park()
        with findings.under():
            if self.park.between_runs:
                check_parked(self.configured_by_steps)
        with findings.under():
            self._check_ramp()
        with findings.under():
            self.starting_sets()

    @property
    def objectives(self) -> tuple[Objective, ...]:
        """The objective, and the further ones if there are any."""
        return (self.objective, *self.further_objectives)

    def from_predicted_cost(self, cost: ArrayLike) -> Array:
        """Return the objective for a predicted cost; of several, the cost of the compromise.

        Parameters
        ----------
        cost : array-like
            The predicted cost, of any shape: that of the objective, or of several the Chebyshev
            distance, which has no unit.
        """
        if len(self.objectives) > 1:
            return np.asarray(cost, dtype=np.float64)
        return self.objective.from_cost(cost)

    @property
    def plays_bags(self) -> bool:
        """Whether its runs play bags."""
        return self.run is not None and self.run.play is not None

    def bag_in(self, context: Context) -> str:
        """Return the bag, or the piece of one, that a run in a context plays; empty without any."""
        play = None if self.run is None else self.run.play
        return "" if play is None else filled_text(play.bag, context)

    @property
    def steps(self) -> Iterable[tuple[KeyPath, Step]]:
        """The steps of its runs, each with its key path; none where a node performs them."""
        return () if self.run is None else self.run.steps

    @property
    def settings(self) -> Iterable[tuple[KeyPath, SetParameter]]:
        """The parameters that steps of its runs set, each with its key path."""
        return () if self.run is None else self.run.settings

    @property
    def growing_metrics(self) -> list[str]:
        """Names of the metrics that only grow during a run."""
        return [name for name, metric in self.metrics.items() if not why_not(metric)]

    @property
    def decisive_metrics(self) -> list[str]:
        """Names of the metrics by which a run of a trial may be cut short; empty if it is not."""
        if not self.budget.cut_short:
            return []
        return decisive(self.metrics, self.constraints.values(), self.objectives)

    @property
    def relative_metrics(self) -> dict[str, RelativeMetric]:
        """Metrics for which the default is run beside each evaluation, by name."""
        return {k: m for k, m in self.metrics.items() if isinstance(m, RelativeMetric)}

    @property
    def is_noiseless(self) -> bool:
        """Whether it declares its runs free of noise."""
        return self.noise == NONE

    @property
    def a_run_tells_all(self) -> bool:
        """Whether all runs of a parameter set have the same metrics: no noise, and one context."""
        return self.is_noiseless and not self.contexts and not self.measured

    @property
    def responses(self) -> list[str]:
        """Names of the metrics that may depend on the parameters: all but the measured contexts."""
        return [name for name in self.metrics if name not in self.measured]

    @property
    def of_plant(self) -> list[str]:
        """Names of the metrics of the plant by themselves: no measured time, nothing computed."""
        return [
            name
            for name in self.responses
            if not isinstance(self.metrics[name], COMPUTED) and not self.metrics[name].measures_time
        ]

    @property
    def logarithmic_metrics(self) -> list[str]:
        """Names of the metrics of which the study takes the logarithm, which must be positive."""
        objectives = {item.metric for item in self.objectives if item.scale == LOG}
        return [k for k, m in self.metrics.items() if m.scale == LOG or k in objectives]

    @property
    def needs_folder(self) -> bool:
        """Whether it names programs, code or files that may lie in its folder."""
        return self.names_programs or (self.run is not None and self.run.needs_folder)

    @property
    def names_programs(self) -> bool:
        """Whether it names programs or code that may lie in its folder."""
        return any(
            node.command or node.launch or node.object or node.parameter_file
            for node in self.nodes.values()
        ) or any(isinstance(metric, PythonMetric) for metric in self.metrics.values())

    def __getstate__(self) -> dict[str, Any]:
        """Leave out cached values: another process computes them from the fields."""
        return {item.name: getattr(self, item.name) for item in dataclasses.fields(self)}

    def search_space(self) -> SearchSpace:
        """Return the unit cube over the tuned parameters."""
        return self._search_space

    @cached_property
    def _search_space(self) -> SearchSpace:
        # Shared by studies that differ only in other sections.
        return search_space(tuple(self.parameters.values()), self.order, self.where)

    @property
    def safe_parameters(self) -> dict[str, Value]:
        """All parameters, as they are while no run is performed."""
        space = self.search_space()
        return space.permitted(space.defaults | dict(self.park.parameters))

    @property
    def tuned_names(self) -> list[str]:
        """Names of the tuned parameters, with those that follow from an equality of others."""
        return [name for name, item in self.parameters.items() if item.is_tuned]

    @property
    def parameters_of_nodes(self) -> list[Parameter]:
        """The parameters that nodes have; others stand only in the steps of a run."""
        return [item for item in self.parameters.values() if item.node]

    @property
    def own_parameters(self) -> dict[str, set[str]]:
        """Names of the ROS parameters that it sets, by node; of all others a node keeps its own."""
        assigned = self.nominal_assignments(self.search_space().defaults)
        names = {
            key: {*spec.parameters, *assigned.get(key, {})} for key, spec in self.nodes.items()
        }
        for each in self.parameters_of_nodes:
            # Also those that the default does not have.
            names[each.node].add(each.array or each.parameter)
        for _, item in self.settings:
            names[item.node].add(item.parameter)
        return names

    def without_safe_parameters(self) -> "Study":
        """Return the study as it is if ``park`` names no parameters."""
        return dataclasses.replace(self, park=dataclasses.replace(self.park, parameters={}))

    def nominal_assignments(
        self, parameters: Mapping[str, Value]
    ) -> dict[str, dict[str, checks.ParameterValue]]:
        """Return `assignments` in the nominal context with the seed 0."""
        contexts = self.context_space()
        return self.assignments(parameters, contexts.to_dict(contexts.nominal()), 0)

    def complete_set(self, given: GivenSet) -> dict[str, Value]:
        """Return the parameter set with some values given, and the default elsewhere.

        Raises
        ------
        StudyError
            If it is not a parameter set of the study.
        """
        space = self.search_space()
        checks.mapping(given)
        try:
            complete = space.permitted({**space.defaults, **given})
        except ParameterError as error:
            raise StudyError(str(error)) from None
        self.check_given(given, complete)
        for name, value in given.items():
            self.parameters[name].check_grid(value, name)
        return complete

    def check_given(self, given: GivenSet, complete: Mapping[str, Value], *path: str) -> None:
        """Refuse values, at a path, that a complete set made of them does not have.

        Raises
        ------
        StudyError
            If a parameter is not active there, or computed to be another value.
        """
        inactive = self.search_space().inactive(complete)
        for name, value in given.items():
            if name in inactive:
                when = self.parameters[name].when
                raise StudyError(f"is there only when {when}", (*path, name))
            if not _agree(complete[name], self.parameters[name].in_trials(value, *path, name)):
                raise StudyError(
                    f"expected {complete[name]}, as the study sets it, found {checks.show(value)}",
                    (*path, name),
                )

    def starting_sets(self) -> list[dict[str, Value]]:
        """Return the different parameter sets of `start`, complete and in its order.

        Raises
        ------
        StudyError
            If one is not a parameter set of the study, or there are more than trials.
        """
        space = self.search_space()
        sets: dict[object, dict[str, Value]] = {}
        for index, given in enumerate(self.start):
            try:
                complete = self.complete_set({} if isinstance(given, str) else given)
            except StudyError as error:
                raise error.under("start", index) from None
            sets.setdefault(space.key(complete), complete)
        if len(sets) > self.budget.trials:
            raise StudyError(
                f"{len(sets)} parameter sets are more than the "
                f"{counted(self.budget.trials, 'trial')}",
                ("start",),
            )
        return list(sets.values())

    def on_screen(self, parameters: Mapping[str, Value]) -> dict[str, Value]:
        """Return a parameter set as screens show it: blank where a parameter is not active."""
        return {**parameters, **dict.fromkeys(self.search_space().inactive(parameters), "")}

    def context_space(self) -> ContextSpace:
        """Return the context variables' box and distribution."""
        return self._context_space

    @cached_property
    def _context_space(self) -> ContextSpace:
        return ContextSpace(
            {name: item.distribution for name, item in self.contexts.items()},
            [name for name, item in self.contexts.items() if item.type == INTEGER],
        )

    @property
    def configured_by_steps(self) -> list[str]:
        """Names of tuned nodes that steps of `before` configure in each run."""
        keys = {item.node for item in self.parameters.values()} & self.nodes.keys()
        return configured_by_steps(self.run, frozenset(self.nodes[key].node for key in keys))

    @property
    def start_names(self) -> dict[str, frozenset[str]]:
        """Names of the parameters that nodes take only while they start, by node key."""
        return start_names(self.nodes, self.parameters, self.contexts, self.seed_parameter)

    @property
    def starts_nodes(self) -> bool:
        """Whether it says how to start a node; other nodes may start along with that one."""
        return any(spec.is_started for spec in self.nodes.values())

    @property
    def drawn_constraints(self) -> tuple[Constraint, ...]:
        """Constraints over the distribution of the contexts, which draws can show."""
        return tuple(c for c in self.constraints.values() if not c.rule.in_every_context)

    @property
    def worst_case_constraints(self) -> tuple[Constraint, ...]:
        """Constraints that must hold in every context."""
        return tuple(c for c in self.constraints.values() if c.rule.in_every_context)

    def limited(self, constraint: Constraint) -> str:
        """Return what screens call the metric of a limit: the ``lowest`` one for a lower limit."""
        title = self.metrics[constraint.metric].title
        return title if constraint.sign > 0.0 else f"lowest {title}"

    def titled(self, constraint: Constraint, text: str) -> str:
        """Return a text on a constraint, with its name if another one limits the same side."""
        same = [
            item
            for item in self.constraints.values()
            if (item.metric, item.sign) == (constraint.metric, constraint.sign)
        ]
        return text if len(same) == 1 else f"{text} ({constraint.name})"

    def limit_title(self, constraint: Constraint) -> str:
        """Return what screens call a limit."""
        return self.titled(constraint, self.limited(constraint))

    def assignments(
        self, parameters: Mapping[str, Value], context: Context, seed: int
    ) -> dict[str, dict[str, checks.ParameterValue]]:
        """Return the parameters to set on each node before an evaluation.

        Parameters
        ----------
        parameters : mapping from str to int or float
            Values of the study's parameters, in own units.
        context : mapping from str to value
            Values of the context variables, in own units; those without a node are not in the
            result.
        seed : int
            Noise seed of the evaluation; unused without a `seed_parameter`.

        Returns
        -------
        dict from str to dict
            Values by the node's name in the study, then by the node's own parameter name.
        """
        values = self.node_parameters(parameters)
        for name, value in context.items():
            variable = self.contexts[name]
            if variable.node:
                values.setdefault(variable.node, {})[variable.parameter] = value
        if self.seed_parameter is not None:
            values.setdefault(self.seed_parameter.node, {})[self.seed_parameter.parameter] = seed
        return values

    def as_given(self, parameters: Mapping[str, Value]) -> dict[str, Any]:
        """Return a parameter set as a function has it: what is active, and lists as lists."""
        active = self.search_space().active(parameters)
        return {name: self.parameters[name].as_sent(value) for name, value in active.items()}

    def node_parameters(
        self, parameters: Mapping[str, Value]
    ) -> dict[str, dict[str, checks.ParameterValue]]:
        """Return a parameter set in the form that nodes take: whole arrays in place of their items.

        The values are by the node's name in the study, then by the node's own parameter name;
        parameters without a node, and those that are not active, are not among them.
        """
        return self._by_node(self.search_space().active(parameters))

    @property
    def all_node_parameters(self) -> dict[str, dict[str, checks.ParameterValue]]:
        """All parameters of nodes, in the form that these take, with their defaults."""
        return self._by_node(self.search_space().defaults)

    def _by_node(
        self, parameters: Mapping[str, Value]
    ) -> dict[str, dict[str, checks.ParameterValue]]:
        values: dict[str, dict[str, checks.ParameterValue]] = {}
        for name, value in parameters.items():
            item = self.parameters[name]
            if not item.node:
                continue
            of_node = values.setdefault(item.node, {})
            if not item.array:
                sent = item.as_sent(value)
                of_node[item.parameter] = tuple(sent) if item.is_list else sent
                continue
            items = of_node.get(item.array, self.nodes[item.node].parameters[item.array])
            if isinstance(items, tuple):
                items = (*items[: item.item], value, *items[item.item + 1 :])
                # The array is one of doubles, even if its constant items are written as integers.
                of_node[item.array] = (
                    tuple(map(float, items)) if isinstance(value, float) else items
                )
        return values

    def replace(
        self,
        *,
        seed: int | None = None,
        trials: int | None = None,
        initial_trials: int | None = None,
        drawn_contexts: int | None = None,
        search_evaluations: int | None = None,
        validation_draws: int | None = None,
        evaluations: int | None = None,
        start: Sequence[Mapping[str, Value]] = (),
    ) -> "Study":
        """Return the study with another seed or budget, checked again; None keeps a value.

        The parameter sets in `start` are tried after those that the study has.

        With `trials` alone, no number of evaluations limits the run; with `evaluations` alone, no
        other number of trials does.

        Raises
        ------
        StudyError
            If a value violates a rule.
        """
        given = {
            "trials": trials,
            "initial_trials": initial_trials,
            "drawn_contexts": drawn_contexts,
            "search_evaluations": search_evaluations,
            "validation_draws": validation_draws,
            "evaluations": evaluations,
        }
        changes: dict[str, Any] = {key: value for key, value in given.items() if value is not None}
        if trials is not None and evaluations is None:
            changes["evaluations"] = None
        if evaluations is not None and trials is None:
            most = max(evaluations, self.budget.initial_trials)
            changes["trials"] = min(most, maxima.TRIALS)
        with under("budget"):
            budget = dataclasses.replace(self.budget, **changes)
        return dataclasses.replace(
            self,
            budget=budget,
            seed=self.seed if seed is None else seed,
            start=(*self.start, *start),
        )

    def _check_park(self) -> None:
        """Refuse safe parameters that the study cannot set."""
        path = ("park", "parameters")
        for name in self.park.parameters:
            checks.reference(name, "parameter", self.parameters, *path)
            if not self.parameters[name].is_tuned:
                raise StudyError("is not tuned; expected tuned parameters only", (*path, name))
        try:
            safe = self.safe_parameters
        except ParameterError as error:
            raise StudyError(str(error), path) from None
        self.check_given(self.park.parameters, safe, *path)

    def _check_ramp(self) -> None:
        """Refuse a ramp on whose way orders and conditions need not hold."""
        if self.run is None or self.run.ramp is None or not (self.order or self.where):
            return
        if problem := broken_on_lines(self.search_space()):
            raise StudyError(
                f"a straight line between two parameter sets leads through one that is not "
                f"permitted ({problem}); leave out ramp, or this rule",
                ("run", "ramp"),
            )


def _agree(own: Value, given: object) -> bool:
    """Whether a value is the study's own; one that is computed need not be so to the last bit."""
    if isinstance(own, float) and isinstance(given, int | float):
        return math.isclose(own, given, rel_tol=1e-9)
    return own == given


def _joined(metrics: Mapping[str, StudyMetric], findings: Findings) -> dict[str, StudyMetric]:
    """Return the metrics, with references to the others in those that are computed from others."""
    joined = dict(metrics)
    # Combined metrics first: a relative metric may be of a combined one.
    for kind in (CombinedMetric, RelativeMetric):
        for name, item in metrics.items():
            if isinstance(item, kind):
                with findings.under("metrics", name):
                    joined[name] = item.joined(joined)
    return joined


def _one_limit_each(
    constraints: Mapping[str, Constraint], taken: Collection[str]
) -> dict[str, Constraint]:
    """Return the constraints by name, each with one limit; names in `taken` are refused."""
    limits: dict[str, Constraint] = {}
    for name, item in constraints.items():
        if item.name != name:
            raise StudyError(f"is called '{item.name}' in itself", ("constraints", name))
        for side in item.sides():
            if side.name in taken:
                raise StudyError(
                    f"the models call another one '{side.name}'; choose another name",
                    ("constraints", name),
                )
            if side.name in limits or (side is not item and side.name in constraints):
                raise StudyError(
                    f"is split into '{side.name}' and another, but there is such a constraint",
                    ("constraints", name),
                )
            limits[side.name] = side
    return limits
