"""The parameters of one node, through its standard services."""

import re
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import (
    ParameterDescriptor,
    ParameterType,
    ParameterValue,
    SetParametersResult,
)
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)

from bo_tuner.backends.ros.errors import SilentError
from bo_tuner.backends.ros.parameters.messages import named_values, to_messages, to_value
from bo_tuner.backends.ros.tuner_node import Calls, TunerNode
from bo_tuner.text import brief

Values = Mapping[str, object]
NAMES = {
    SetParametersAtomically: "set_parameters_atomically",
    SetParameters: "set_parameters",
    GetParameters: "get_parameters",
    ListParameters: "list_parameters",
    DescribeParameters: "describe_parameters",
}
SETTING = (SetParametersAtomically, SetParameters)
FIELDS = {
    SetParameters: ("parameters", "results"),
    GetParameters: ("names", "values"),
    DescribeParameters: ("names", "descriptors"),
}
"""What is asked of several parameters, and answered."""
NOT_ATOMIC = (
    "sets no parameters together; they are set one after the other, and set back if it refuses one"
)
WITHOUT = {
    SetParametersAtomically: f"no service set_parameters_atomically: it {NOT_ATOMIC}",
    ListParameters: "no service list_parameters: only what the study sets is read and held",
    DescribeParameters: "no service describe_parameters: its ranges are not known",
}
"""What is done without a service."""
NOT_OFFERED = re.compile(r"atomic|support|implement|^\s*$", re.IGNORECASE)
"""Words of a node that sets no parameters together, if there is no better sign of that."""
INCOMPLETE = 2.0
"""Time [s] without a further service after which those that are missing are done without."""
ATTEMPT = 1.0
"""Time [s] after which a request that changes nothing is repeated: a node that was killed stays
discovered until its lease ends, and one may receive a request before it has discovered who asks."""


class ParameterClient:
    """Calls the parameter services of a node.

    What gives `Calls` is for `TunerNode.complete`. Nodes that are no full ROS nodes, such as those
    on a microcontroller, lack some of the services or take one parameter at a time.

    Attributes
    ----------
    on_request, on_refusal : callable
        Called with the values of each request to set some, ahead of it, and if it is refused.
    """

    def __init__(self, tuner: TunerNode, node: str, *services: Any) -> None:
        self.node = node
        self.on_request: Callable[[Values], None] = lambda values: None
        self.on_refusal: Callable[[Values], None] = lambda values: None
        self._tuner = tuner
        self._types: dict[str, int] = {}
        self._is_atomic: bool | None = None
        self._one_by_one: bool | None = None
        self._ready: set[Any] = set()
        self._remarked: list[str] = []
        self._since = 0.0
        # A node that answers a later client knows the earlier ones.
        setting = SETTING if SetParametersAtomically in services else ()
        kinds = (*setting, GetParameters, *(kind for kind in services if kind not in SETTING))
        self._clients = {
            kind: tuner.node.create_client(kind, f"{node}/{NAMES[kind]}")
            for kind in dict.fromkeys(kinds)
        }

    def destroy(self) -> None:
        """Leave the services."""
        for client in self._clients.values():
            self._tuner.node.destroy_client(client)

    def is_ready(self) -> bool:
        """Whether all services are discovered, or those that are needed, and no more come."""
        ready = {kind for kind in self._clients if self.offers(kind)}
        if ready != self._ready:
            self._ready, self._since = ready, time.monotonic()
        if ready >= self._clients.keys():
            return True
        setting = {*SETTING} & self._clients.keys()
        if GetParameters not in ready or (setting and not setting & ready):
            return False
        return time.monotonic() - self._since > INCOMPLETE

    def offers(self, kind: Any) -> bool:
        """Whether a service is discovered."""
        return kind in self._clients and self._clients[kind].service_is_ready()

    def servers(self) -> int:
        """Count the nodes that answer under this name."""
        return self._tuner.node.count_services(self._clients[GetParameters].srv_name)

    def take_remarks(self) -> list[str]:
        """Return lines, each of them once, on what the node lacks and what is done instead."""
        missing = self._clients.keys() - self._ready
        remarks = [text for kind, text in WITHOUT.items() if kind in missing]
        if self._is_atomic is False and SetParametersAtomically not in missing:
            remarks.append(NOT_ATOMIC)
        new = [text for text in remarks if text not in self._remarked]
        self._remarked += new
        return [f"{self.node}: {text}" for text in new]

    def expect_answers(self, deadline: float) -> None:
        """Have the services that read answer, until a time of `monotonic`.

        To set no parameter would call functions of the node's author with a list that is empty,
        which they need not expect.
        """
        for kind in self._clients:
            if kind in SETTING or (kind is not GetParameters and not self.offers(kind)):
                continue
            # A request to a node that is not discovered in full is lost; one that is slow is not
            # asked again and again before it has answered.
            attempt = ATTEMPT
            while True:
                try:
                    self._tuner.complete([self._calling(kind, kind.Request())], attempt)
                    break
                except SilentError:
                    if time.monotonic() > deadline:
                        raise
                    attempt *= 2.0

    def names(self) -> Calls:
        """List the parameters; none if the node does not list them."""
        if not self.offers(ListParameters):
            return []
        request = ListParameters.Request(depth=ListParameters.Request.DEPTH_RECURSIVE)
        return list((yield from self._calling(ListParameters, request)).result.names)

    def descriptors(self, names: Sequence[str]) -> Calls:
        """Describe parameters; empty descriptors where the node does not."""
        if not self.offers(DescribeParameters):
            return [ParameterDescriptor(name=name) for name in names]
        descriptors = yield from self._asking(DescribeParameters, names)
        return [
            item or ParameterDescriptor(name=n) for n, item in zip(names, descriptors, strict=True)
        ]

    def messages(self, names: Sequence[str]) -> Calls:
        """Read parameters as messages, not set where the node does not have one."""
        messages = yield from self._asking(GetParameters, names)
        messages = [item or ParameterValue() for item in messages]
        self._types |= {name: item.type for name, item in zip(names, messages, strict=True)}
        return messages

    def values(self, names: Sequence[str]) -> Calls:
        """Read parameters, by name; None where the node does not have one."""
        messages = yield from self.messages(names)
        return dict(zip(names, map(to_value, messages), strict=True))

    def set(self, values: Values) -> Calls:
        """Set parameters, all of them or none; returns the result.

        A node that does not set several at once is given one after the other, and those before if
        it refuses one.
        """
        messages = to_messages(values, self._types)
        # A node may take them and not answer.
        self._types |= {item.name: item.value.type for item in messages}
        if not self.offers(SetParameters):
            return (yield from self._set_atomically(messages))
        refusal = None
        # Where there is no room for several, such a request may not even be read.
        tries = self._is_atomic is not False and not self._one_by_one
        if tries and self.offers(SetParametersAtomically):
            refusal = yield from self._set_atomically(messages)
            if refusal.successful or (yield from self._takes_its_own(refusal, list(values))):
                self._is_atomic = True
                return refusal
        result, reasons = yield from self._set_each(messages)
        if refusal is not None and reasons == {refusal.reason}:
            # It takes nothing at all now, in whatever way.
            return refusal
        self._is_atomic = False
        return result

    def _set_atomically(self, messages: Sequence[ParameterMessage]) -> Calls:
        values = named_values(messages)
        self.on_request(values)
        request = SetParametersAtomically.Request(parameters=messages)
        result = (yield from self._calling(SetParametersAtomically, request)).result
        if not result.successful:
            self.on_refusal(values)
        return result

    def _takes_its_own(self, refusal: SetParametersResult, names: Sequence[str]) -> Calls:
        """Whether a node has refused these values, and not every request of this kind.

        A node that takes no request of this kind refuses the values that it has, too.
        """
        if self._is_atomic:
            return True
        present = zip(names, (yield from self.messages(names)), strict=True)
        own = [
            ParameterMessage(name=name, value=value)
            for name, value in present
            if value.type != ParameterType.PARAMETER_NOT_SET
        ]
        for message in own:
            # Of several one may be read-only.
            if (yield from self._set_atomically([message])).successful:
                return True
        return not own and not NOT_OFFERED.search(refusal.reason)

    def _set_each(self, messages: Sequence[ParameterMessage]) -> Calls:
        """Set parameters one by one, all or none; returns the result, and the reasons if none."""
        names = [item.name for item in messages]
        before = dict(zip(names, (yield from self.messages(names)), strict=True))
        refused = yield from self._set_in_any_order(messages)
        if not refused:
            return SetParametersResult(successful=True), set()
        done = [name for name in reversed(names) if name not in refused]
        back = [ParameterMessage(name=name, value=before[name]) for name in done]
        stuck = yield from self._set_in_any_order(back)
        reasons = [f"{name}: {brief(why) or 'no reason given'}" for name, why in refused.items()]
        reasons += [f"{name} could not be set back: {brief(why)}" for name, why in stuck.items()]
        result = SetParametersResult(successful=False, reason="; ".join(reasons))
        return result, set() if done else set(refused.values())

    def _set_in_any_order(self, messages: Sequence[ParameterMessage]) -> Calls:
        """Set parameters; those that are refused once more after others were set.

        A node may refuse a lower limit above an upper one that is still to come. Returns by name
        why the rest is refused.
        """
        refused: dict[str, str] = {}
        left = list(messages)
        while left:
            results = yield from self._set_several(left)
            refused = {
                item.name: str(result.reason)
                for item, result in zip(left, results, strict=True)
                if not result.successful
            }
            if len(refused) == len(left):
                return refused
            left = [item for item in left if item.name in refused]
        return {}

    def _set_several(self, messages: Sequence[ParameterMessage]) -> Calls:
        """Set parameters one after the other; returns a result for each."""
        for item in messages:
            self.on_request(named_values([item]))
        results = yield from self._asking(SetParameters, messages)
        results = [result or SetParametersResult() for result in results]
        for item, result in zip(messages, results, strict=True):
            if not result.successful:
                self.on_refusal(named_values([item]))
        return results

    def _asking(self, kind: Any, items: Sequence[Any]) -> Calls:
        """Ask for something of each item; returns the answers, None where there is none.

        A node may answer nothing at all if it lacks one of them, or has no room for so many.
        """
        asked, answered = FIELDS[kind]
        many = len(items) > 1
        if not many or not self._one_by_one:
            try:
                response = yield from self._calling(kind, kind.Request(**{asked: items}))
                answers = list(getattr(response, answered))
                if len(answers) == len(items):
                    self._one_by_one = False if many else self._one_by_one
                    return answers
            except SilentError:
                if not many or self._one_by_one is False:
                    raise
                # Either it is gone, or it answers this.
                first = yield from self._asking(kind, items[:1])
                self._one_by_one = True
                return first + (yield from self._asking(kind, items[1:]))
        if not many:
            return [None for _ in items]
        answers = []
        for item in items:
            answers += yield from self._asking(kind, [item])
        return answers

    def _calling(self, kind: Any, request: Any) -> Calls:
        return self._tuner.calling(self._clients[kind], request, self.node)


def meet(tuner: TunerNode, node: str, deadline: float) -> None:
    """Wait until a node sends here all that this process has subscribed to so far.

    What it publishes before is lost, even if its publishers are known here. But it discovers the
    subscriptions in the order in which they were made, so one that answers a new client knows all
    earlier ones. One without parameter services is not waited for.
    """
    client = ParameterClient(tuner, node, GetParameters)
    try:
        if not client.servers():
            return
        tuner.wait_until(client.is_ready, deadline - time.monotonic())
        client.expect_answers(deadline)
    finally:
        client.destroy()
