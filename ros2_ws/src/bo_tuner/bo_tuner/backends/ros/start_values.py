"""Values that nodes take only while they start, or while they are configured, brought into force.

Such a node accepts another value at any time, and reads it back, but goes on as before.
"""

import contextlib
import time
from collections.abc import Callable, Collection, Mapping, Sequence

from bo_tuner.backends.ros.errors import LostError, RefusedError
from bo_tuner.backends.ros.lifecycle import ACTIVE, UNCONFIGURED
from bo_tuner.backends.ros.parameters.events import Difference, Values, differences
from bo_tuner.backends.ros.parameters.nodes import NodeParameters
from bo_tuner.backends.ros.reconfiguration import Reconfiguration, reconfiguration_of
from bo_tuner.backends.ros.started_nodes import StartedNodes
from bo_tuner.backends.ros.tuner_node import TunerNode
from bo_tuner.codec.findings import under
from bo_tuner.errors import BackendError, StudyError
from bo_tuner.study.at_start import starter_of
from bo_tuner.study.configuring import is_named
from bo_tuner.study.nodes import PARAMETER_FILE
from bo_tuner.study.safe_values import safe_in_braces
from bo_tuner.study.study import Study
from bo_tuner.text import brief
from bo_tuner.trials import Value

FAULTS = (RefusedError, LostError, StudyError, BackendError)
"""Why values may not come into force."""


class StartValues:
    """Has nodes with ``at_start`` run with their values.

    Attributes
    ----------
    restart : callable
        Starts a node anew, by its key, which is then `settle`d.
    between : callable
        Called when nodes have ended that are started anew next, or those of some names are
        unconfigured.
    after : callable
        Called when they are there again.
    """

    def __init__(
        self,
        study: Study,
        tuner: TunerNode,
        parameters: NodeParameters,
        started: StartedNodes | None,
    ) -> None:
        self._study = study
        self._tuner = tuner
        self._parameters = parameters
        self._started = started
        self._names = study.start_names
        self._safe: Values = {}
        self._in_force: dict[str, Mapping[str, object]] = {}
        self._last: dict[str, tuple[Mapping[str, object], Mapping[str, object]]] = {}
        self._ways: dict[str, Reconfiguration | None] = {}
        self._targets: dict[str, str] = {}
        self._configured: set[str] = set()
        self.restart: Callable[[Sequence[str]], None] = lambda keys: None
        self.between: Callable[[Collection[str]], object] = lambda names: None
        self.after: Callable[[], object] = lambda: None
        self._starts: list[float] = []

    def reset(self, safe: Values | None = None) -> None:
        """Have nodes that are started next begin with safe values, given once."""
        self._safe = self._safe if safe is None else safe
        self._in_force.clear()
        if self._started is None:
            return
        self.fill({})
        for key in self._names:
            spec = self._study.nodes[key]
            if not spec.reconfigure:
                self._starter(key)
            own = {**spec.parameters, **self._safe.get(key, {})}
            self._started.values[key] = self._part(key, own)

    def fill(self, values: Mapping[str, Value]) -> None:
        """Have names in braces, in what starts nodes, stand for these values or the safe ones."""
        if self._started is not None:
            self._started.in_braces = {**safe_in_braces(self._study), **values}

    def settle_all(self) -> None:
        """`settle` all nodes, once they are there."""
        if self._started is None:
            for key, spec in self._study.nodes.items():
                for path, name in spec.names_in_braces:
                    raise StudyError(
                        f"{key} is attached, and is not started with {name}; leave out --attach",
                        ("nodes", key, *path),
                    )
        for key in self._names:
            if self._started is not None:
                self.settle(key)
            elif self._way(key) is None:
                raise StudyError(
                    f"{key} is attached, and has no lifecycle; only a node that the tuner starts "
                    "can be given values at its start: leave out --attach",
                    ("nodes", key, "at_start"),
                )

    def settle(self, key: str) -> None:
        """See that a node just started has its values, and bring it up by its lifecycle."""
        if key not in self._names or self._started is None:
            return
        given = self._started.values[key]
        node = self._way(key)
        if node is not None:
            target = self._target(key, node)
            if self._is_launched(key):
                node.wait_for(target)
            node.bring_to(target)
            self._targets.pop(key, None)
            # It may have declared some just now.
            self._parameters.forget(key)
        known = self._parameters.known(key) or self._parameters.read_anew(key)
        if node is not None and node.state == UNCONFIGURED:
            # It declares the others when it is configured.
            given = {name: value for name, value in given.items() if name in known}
        if wrong := differences(key, known, given):
            if self._study.nodes[key].reconfigure:
                self._reconfigure(key, given)
                return
            self._refuse(key, given, known, wrong)
        self._last[key] = given, {name: known[name] for name in given}
        self._in_force[key] = self._started.values[key]

    def started_by(self, starter: str) -> list[str]:
        """Return the keys of nodes with ``at_start`` that the start of a node brings up."""
        return [key for key in self._names if starter_of(self._study.nodes, key) == starter]

    def forget(self, key: str) -> None:
        """Forget what is in force on a node that was started anew."""
        self._in_force.pop(key, None)

    def forget_all(self) -> None:
        """Forget it of all nodes, so that values come into force anew whatever they are."""
        self._in_force.clear()
        if self._started is not None:
            self._started.forget_given()

    def due(self, wanted: Values) -> list[str]:
        """Return the keys of nodes on which other values must come into force."""
        return [key for key in self._study.nodes if not self._is_in_force(key, wanted.get(key, {}))]

    def as_started(self, key: str, values: Mapping[str, object]) -> dict[str, object]:
        """Return values for a node that is not to start anew: what is in force stays as it is."""
        names = self._names.get(key, frozenset())
        others = {name: value for name, value in values.items() if name not in names}
        return others | dict(self._in_force.get(key, {}))

    def bring(self, wanted: Values, keys: Collection[str] | None = None) -> None:
        """Bring values into force, on nodes that do not run with them."""
        due = self.due(wanted) if keys is None else keys
        restarts = [key for key in due if not (self._reconfigures(key) and self._is_given(key))]
        for starter in dict.fromkeys(map(self._starter, restarts)):
            began = time.monotonic()
            self._start_anew(starter, wanted)
            self._note(began)
        for key in due:
            # One that a start has brought up has its values.
            if not self._is_in_force(key, wanted.get(key, {})):
                began = time.monotonic()
                self._reconfigure(key, wanted[key])
                self._note(began)

    def bring_each(self, wanted: Values, keys: Collection[str]) -> dict[str, Exception]:
        """Bring values into force as far as possible; returns by key why that failed."""
        failed: dict[str, Exception] = {}
        for key in keys:
            # Nodes of one process come together.
            if self._is_in_force(key, wanted.get(key, {})):
                continue
            try:
                self.bring(wanted, [key])
            except FAULTS as error:
                failed[key] = error
        return failed

    def take_starts(self) -> list[float]:
        """Return the times [s] that starts and configurations took since this was last asked.

        Each is from the end of the process before until the node is up, publishes and has its
        values.
        """
        starts, self._starts = self._starts, []
        return starts

    def reconfigure_restored(self) -> list[str]:
        """Let attached nodes take what they were given back; returns what went wrong, in lines."""
        problems = []
        for key in sorted(self._configured) if self._started is None else ():
            values = self._parameters.known(key)
            if self._is_in_force(key, values):
                continue
            try:
                self._reconfigure(key, self._part(key, values))
            except FAULTS as error:
                node = self._study.nodes[key].node
                problems.append(f"{node} has its previous parameters, but not in force: {error}")
        return problems

    def _note(self, began: float) -> None:
        self._starts.append(time.monotonic() - began)

    def _part(self, key: str, values: Mapping[str, object]) -> dict[str, object]:
        return {name: values[name] for name in sorted(self._names[key]) if name in values}

    def _is_given(self, key: str) -> bool:
        """Whether a node was started with what names in braces stand for now."""
        return self._started is None or self._started.is_given(key)

    def _is_in_force(self, key: str, wanted: Mapping[str, object]) -> bool:
        if not self._is_given(key):
            return False
        if key not in self._names:
            return True
        part, in_force = self._part(key, wanted), self._in_force.get(key)
        # Somebody else may have set another value: to set it back would not bring it into force.
        known = self._part(key, self._parameters.known(key))
        return in_force is not None and not (
            differences(key, in_force, part) or (known and differences(key, known, part))
        )

    def _starter(self, key: str) -> str:
        starter = starter_of(self._study.nodes, key)
        if starter is None:
            raise StudyError(
                f"the study does not say how the tuner starts {key} with its values; add command, "
                f"executable or launch, or put {PARAMETER_FILE} into the command or launch that "
                "starts it along",
                ("nodes", key, "at_start"),
            )
        return starter

    def _is_launched(self, key: str) -> bool:
        starter = starter_of(self._study.nodes, key)
        started = self._study.nodes if starter is None else (starter,)
        return any(self._study.nodes[other].launch for other in started)

    def _start_anew(self, starter: str, wanted: Values) -> None:
        if self._started is None:
            raise LostError(f"{starter} is attached, and cannot be started anew")
        for key in self.started_by(starter):
            self._started.values[key] = self._part(key, wanted[key])
            self._remember_state(key)
            self._in_force.pop(key, None)
        try:
            self.restart([starter])
        except LostError as loss:
            process = self._started.processes.get(starter)
            if process is not None and (reason := process.exit_reason) is not None:
                raise RefusedError(
                    f"{starter} does not start with these parameters: {reason}"
                ) from loss
            raise

    def _refuse(
        self,
        key: str,
        given: Mapping[str, object],
        actual: Mapping[str, object],
        wrong: Collection[Difference],
    ) -> None:
        """Raise that a node has other values than it was started with."""
        given_before, actual_before = self._last.get(key, ({}, {}))
        for item in wrong:
            name = item.name
            stays = name in given_before and not differences(
                key, actual, {name: actual_before[name]}
            )
            changed = stays and bool(differences(key, given_before, {name: given[name]}))
            if not given_before or changed or name not in actual:
                has = f"has {brief(str(item.actual))}" if name in actual else "has not declared it"
                raise StudyError(
                    f"{key} was started with {name} {item.expected} in its parameter file, and "
                    f"{has}: a program must pass its arguments on to the node, or its line have "
                    f"{PARAMETER_FILE} where the file goes",
                    ("nodes", key, "at_start"),
                )
            raise RefusedError(f"{item} (not taken by the node at its start)")

    def _way(self, key: str) -> Reconfiguration | None:
        if key not in self._ways:
            with under("nodes", key):
                self._ways[key] = reconfiguration_of(self._tuner, self._study.nodes[key])
        return self._ways[key]

    def _reconfigures(self, key: str) -> bool:
        return self._started is None or bool(self._study.nodes[key].reconfigure)

    def _reconfigure(self, key: str, values: Mapping[str, object]) -> None:
        node = self._way(key)
        if node is None:
            raise StudyError(f"{key} has no lifecycle", ("nodes", key, "reconfigure"))
        self._in_force.pop(key, None)
        self._configured.add(key)
        target = self._targets[key] = self._target(key, node)

        names = [self._study.nodes[key].node.rpartition("/")[2]]

        def assign() -> None:
            if not node.goes_on:
                self.between(names)
            self._parameters.assign_and_read_back(key, values)

        node.configure_anew(target, assign)
        if node.goes_on:
            # What it has published so far is of the values before.
            self.between(names)
        del self._targets[key]
        self._in_force[key] = self._part(key, values)
        if self._started is not None:
            self._started.values[key] = self._in_force[key]
        self.after()

    def _remember_state(self, key: str) -> None:
        """Note in which state a node is to be after its next start, as it is now."""
        node = self._ways.get(key)
        if node is not None and key not in self._targets:
            # One that does not answer is brought up.
            with contextlib.suppress(LostError):
                self._targets[key] = node.state

    def _target(self, key: str, node: Reconfiguration) -> str:
        """Return the state that a node is to be in.

        It is that in which it is. But where the tuner has started it, and no step of the run
        configures it, nobody else activates it.
        """
        state = self._targets.get(key) or node.state
        own = self._started is not None and not self._is_configured_in_run(key)
        return ACTIVE if own and state == UNCONFIGURED else state

    def _is_configured_in_run(self, key: str) -> bool:
        changes = (step.lifecycle for _, step in self._study.steps)
        node = self._study.nodes[key].node
        return any(c is not None and is_named(node, c.node) for c in changes)
