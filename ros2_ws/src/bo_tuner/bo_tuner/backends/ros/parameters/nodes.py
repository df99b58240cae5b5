"""What the nodes of a study are set to, and held at."""

from collections.abc import Callable, Collection, Iterable, Mapping
from functools import partial

from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically

from bo_tuner.backends.ros.errors import DisturbedError, LostError, RefusedError
from bo_tuner.backends.ros.parameters.events import (
    ParameterWatch,
    Readback,
    Values,
    differences,
    disturbed,
    not_taken,
)
from bo_tuner.backends.ros.parameters.services import ParameterClient
from bo_tuner.backends.ros.tuner_node import Calls, TunerNode
from bo_tuner.codec import checks
from bo_tuner.text import brief

Unset = RefusedError | LostError
"""Why a node does not have its values."""


class NodeParameters:
    """The parameters of some nodes: only what a node does not have already is set.

    Attributes
    ----------
    clients : dict from str to ParameterClient
        By the same keys.
    """

    def __init__(
        self,
        tuner: TunerNode,
        nodes: Mapping[str, str],
        own: Mapping[str, Collection[str]],
        is_unwatched: Callable[[str, str], object] = lambda key, name: False,
    ) -> None:
        self._tuner = tuner
        self._is_unwatched = is_unwatched
        self._own = own
        self._expected: Values = {}
        self._changed: dict[str, dict[str, object]] = {}
        self._before: dict[str, dict[str, object]] = {}
        self._known: dict[str, dict[str, object]] = {}
        self._taken: dict[str, dict[str, object]] = {}
        self._names: dict[str, list[str]] = {}
        self._watch = ParameterWatch(tuner.node, nodes)
        services = (SetParametersAtomically, GetParameters, ListParameters)
        self.clients = {key: ParameterClient(tuner, node, *services) for key, node in nodes.items()}
        for key, client in self.clients.items():
            client.on_request = partial(self._watch.expect_event, key)
            client.on_refusal = partial(self._watch.take_back, key)

    def forget(self, key: str) -> None:
        """Forget what a node has, so that it is read, and set, again."""
        self._known.pop(key, None)
        self._taken.pop(key, None)

    def forget_all(self) -> None:
        """Forget what all nodes have."""
        self._known.clear()
        self._taken.clear()

    def read_anew(self, key: str) -> dict[str, object]:
        """Read the parameters of a node that was started anew, and forget its events up to now."""
        (values,) = self._tuner.complete([self._reading_all(key)])
        self._known[key] = dict(values)
        self._watch.forget(key)
        return dict(values)

    def known(self, key: str) -> Mapping[str, object]:
        """Return the values that a node is known to have, without any that is just being set."""
        return self._known.get(key, {})

    def present(self, keys: Iterable[str]) -> dict[str, Mapping[str, object]]:
        """Return the values that nodes are known to have, by key; others are asked."""
        keys = list(keys)
        asked = [key for key in keys if key not in self._known]
        readings = self._tuner.complete([self._reading_all(key) for key in asked])
        self._known |= dict(zip(asked, readings, strict=True))
        return {key: self._known[key] for key in keys}

    def assign(self, key: str, values: Mapping[str, object]) -> list[str]:
        """Set those parameters of a node that it does not have already, all of them or none."""
        (names,) = self._tuner.complete([self._assigning(key, values)])
        return list(names)

    def assign_side_by_side(self, values: Values, timeout: float) -> dict[str, Unset]:
        """Set parameters of nodes at the same time, and read them back.

        A node that hangs does not keep the others waiting.
        """
        failed: dict[str, Unset] = {}

        def assigning(key: str) -> Calls:
            try:
                yield from self._assigning_and_reading_back(key, values[key])
            except (RefusedError, LostError) as error:
                self.forget(key)
                failed[key] = error

        self._tuner.complete([assigning(key) for key in values], timeout)
        return {key: failed[key] for key in values if key in failed}

    def assign_and_read_back(self, key: str, values: Mapping[str, object]) -> None:
        """Set parameters of a node, which must then have these values."""
        self._tuner.complete([self._assigning_and_reading_back(key, values)])

    def unset_side_by_side(
        self, names: Mapping[str, Iterable[str]], timeout: float
    ) -> dict[str, dict[str, str]]:
        """Take parameters back that nodes had not declared, from all nodes at the same time.

        A request to set nothing deletes a parameter, which no node's author expects of one that
        was declared.
        """
        kept: dict[str, dict[str, str]] = {key: {} for key in names}

        def unsetting(key: str) -> Calls:
            for name in names[key]:
                try:
                    why = yield from self._unsetting(key, name)
                except LostError as error:
                    why = str(error)
                if why:
                    kept[key][name] = why

        self._tuner.complete([unsetting(key) for key in names], timeout)
        return kept

    def park(
        self, values: Values, held: Values, timeout: float, later: Collection[str] = ()
    ) -> dict[str, Unset]:
        """Set safe values on all nodes at the same time, whatever somebody else has changed."""
        self._changed, self._before = {}, {}
        self.expect({key: {**held.get(key, {}), **values[key]} for key in values})
        now = {key: values[key] for key in values if key not in later}
        failed = self.assign_side_by_side(now, timeout)
        self._watch.take_seen()
        return failed

    def hold(self, wanted: Values, kept: Mapping[str, Collection[str]]) -> None:
        """Set what nodes must have from now on, until this or `park` is called again."""
        changed = {key: {**v, **self._changed.get(key, {})} for key, v in wanted.items()}
        self.expect(changed)
        assigned = self.assign_held(changed, kept)
        self.read_back().check(assigned)

    def assign_held(
        self, values: Values, kept: Mapping[str, Collection[str]]
    ) -> dict[str, list[str]]:
        """Set parameters of nodes that are held; returns by node key the names of those set.

        For the arguments and exceptions see `hold`.
        """
        return {key: self._assign_held(key, of_node, kept[key]) for key, of_node in values.items()}

    def hold_again(self, key: str) -> None:
        """Set what a node that was started anew must have, and read it back."""
        self.assign_and_read_back(key, self._expected.get(key, {}))

    def change(self, key: str, values: Mapping[str, object]) -> None:
        """Set parameters of a node, and hold it at these until `give_back` or `park`."""
        before = self._before.setdefault(key, {})
        for name in values:
            before.setdefault(name, self._expected.get(key, {}).get(name))
        self._changed.setdefault(key, {}).update(values)
        self._change(key, values)

    def give_back(self) -> None:
        """Set again, and hold, what nodes had before `change`; raises what that raises."""
        before, self._before, self._changed = self._before, {}, {}
        for key, values in before.items():
            self._change(key, {name: v for name, v in values.items() if v is not None})

    def read_back(self) -> Readback:
        """Read what nodes have that are held, and what they had since this was last called."""
        values = self._read(self._expected)
        self._known |= {key: dict(of_node) for key, of_node in values.items()}
        seen, problem = self._watch.take_seen(), self._watch.problem
        return Readback(self._expected, values, seen, problem, self._own)

    def disturbance(self) -> DisturbedError | None:
        """Return what somebody else changed, by the nodes' events since this was last called."""
        seen = self._watch.take_seen()
        return disturbed(seen[0], self._own) if seen else None

    def take_remarks(self) -> list[str]:
        """Return lines, each of them once, on what nodes lack and what is done instead."""
        return [text for client in self.clients.values() for text in client.take_remarks()]

    def undeclared(self, key: str) -> set[str]:
        """Return the names of parameters that are set on a node and that it had not declared."""
        return set(self._own[key]) - set(self._names[key])

    def expect_answer(self, key: str) -> None:
        """Ask a node for no parameter."""
        self._tuner.complete([self.clients[key].values([])])

    def _change(self, key: str, values: Mapping[str, object]) -> None:
        self._expected = {**self._expected, key: {**self._expected.get(key, {}), **values}}
        self._watch.change(self._expected)
        self.assign_and_read_back(key, values)

    def expect(self, values: Values) -> None:
        """Expect nodes to have the values that they are to `hold`, which are not set yet."""
        self._expected = values
        self._watch.expect(values)

    def _assign_held(
        self, key: str, values: Mapping[str, object], kept: Collection[str]
    ) -> list[str]:
        before = dict(self._known.get(key, {}))
        try:
            return self.assign(key, values)
        except RefusedError:
            # A value that somebody else has changed may be why these are refused.
            self._known[key] = self._read([key])[key]
            now = self._known[key]
            # What was set, and could not be taken back, is no change by others.
            others = {n: v for n, v in before.items() if _differs(values, n, now.get(n))}
            changed = differences(key, now, others) + self._watch.take_seen()
            # It may have been changed long ago, and the node not take it back.
            own = {name: value for name, value in values.items() if name in kept}
            changed += differences(key, now, own)
            if changed:
                raise disturbed(changed[0], self._own) from None
            raise

    def _assigning(self, key: str, values: Mapping[str, object]) -> Calls:
        if key not in self._known:
            self._known[key] = yield from self._reading_all(key)
        known = self._known[key]
        taken = self._taken.setdefault(key, {})
        changes = {
            name: value
            for name, value in values.items()
            # What a device has rounded need not be set again.
            if _differs(known, name, value)
            and (_differs(taken, name, value) or not checks.holds(known.get(name), value))
        }
        if not changes:
            return []
        # Until it answers, the node may have the one or the other.
        for name in changes:
            known.pop(name, None)
        result = yield from self.clients[key].set(changes)
        if not result.successful:
            # The refusal of rclpy does not name what is not declared.
            missing = [name for name in changes if name not in self._names[key]]
            also = f" (it has not declared {', '.join(missing)})" if missing else ""
            raise RefusedError(f"{key} refused its parameters: {result.reason}{also}")
        known.update(changes)
        taken.update(changes)
        # A node may take what it has not declared.
        self._names[key] += [name for name in changes if name not in self._names[key]]
        return list(changes)

    def _assigning_and_reading_back(self, key: str, values: Mapping[str, object]) -> Calls:
        # Once more if somebody else has changed what was set before.
        for _ in range(2):
            yield from self._assigning(key, values)
            self._known[key] = yield from self._reading(key)
            wrong = differences(key, self._known[key], values)
            if not wrong:
                return
        raise not_taken(wrong[0])

    def _unsetting(self, key: str, name: str) -> Calls:
        """Delete a parameter; returns why that is not possible."""
        client = self.clients[key]
        value = (yield from client.values([name]))[name]
        if value is None:
            return ""
        result = yield from client.set({name: None})
        self.forget(key)
        if (yield from client.values([name]))[name] is None:
            return ""
        return brief(result.reason) or f"it has {brief(str(value))} still"

    def _reading_all(self, key: str) -> Calls:
        """Read all parameters of a node, whatever it has declared before."""
        listed = yield from self.clients[key].names()
        named = [
            name for name in listed if checks.is_in_node(name) and not self._is_unwatched(key, name)
        ]
        self._names[key] = named or list(self._own.get(key, ()))
        return (yield from self._reading(key))

    def _reading(self, key: str) -> Calls:
        values = yield from self.clients[key].values(self._names[key])
        return {name: value for name, value in values.items() if value is not None}

    def _read(self, keys: Iterable[str]) -> dict[str, dict[str, object]]:
        """Read the parameters of nodes side by side, by key."""
        keys = list(keys)
        readings = self._tuner.complete([self._reading(key) for key in keys])
        return dict(zip(keys, readings, strict=True))


def _differs(known: Mapping[str, object], name: str, value: object) -> bool:
    return name not in known or not checks.same_value(known[name], value)
