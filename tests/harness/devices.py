"""The servo behind parameter services of its own, as of MAVROS, or of rclc on a microcontroller."""

import numpy as np
from rcl_interfaces.msg import ParameterType, SetParametersResult
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.parameter import Parameter
from rclpy.task import Future
from servo import System

DOUBLE = {"node": "servo", "type": "double"}
TWO = {
    "gain": DOUBLE | {"bounds": [0.1, 3.0], "default": 0.5},
    "limited": DOUBLE | {"bounds": [0.0, 2.0], "default": 1.0},
}
"""Two parameters of it in a study."""


class Device(System):
    """The servo, whose parameters are those of a device.

    Parameters
    ----------
    context
        ROS context.
    atomic
        What it says to a request to set parameters together; without that it has no such service.
    room
        Most parameters in a request.
    is_mute
        Whether it does not answer a larger request at all, as one that it cannot even read.
    is_float32
        Whether it keeps doubles in 32 bits.
    lacks
        Names of services that it does not have.

    Attributes
    ----------
    refused : dict
        By parameter why it is refused.
    least : dict
        By parameter another one that it must not be below.
    stays : set
        Parameters that can be changed only once.
    offset : float
        What it adds to a double that it keeps in 32 bits.
    """

    def __init__(
        self, context, *, atomic=None, room=100, is_mute=False, is_float32=False, lacks=()
    ):
        self.requests = []
        self.refused, self.least, self.stays = {}, {}, set()
        self.offset = 0.0
        super().__init__(context, start_parameter_services=False)
        self.room, self.is_mute, self.is_float32 = room, is_mute, is_float32
        for kind, name, answer in (
            (SetParameters, "set_parameters", self.answer_set),
            (GetParameters, "get_parameters", self.answer_get),
            (ListParameters, "list_parameters", self.answer_list),
            (DescribeParameters, "describe_parameters", self.answer_describe),
        ):
            if name not in lacks:
                # What is never answered keeps nobody else waiting.
                group = ReentrantCallbackGroup()
                self.create_service(kind, f"~/{name}", answer, callback_group=group)
        if atomic is not None:

            async def refuse(request, response):
                await self.fits(request.parameters)
                response.result.reason = atomic
                return response

            self.create_service(
                SetParametersAtomically,
                "~/set_parameters_atomically",
                refuse,
                callback_group=ReentrantCallbackGroup(),
            )

    async def fits(self, items):
        """Whether a request has room, if it can be read."""
        if len(items) > self.room and self.is_mute:
            await Future()
        return len(items) <= self.room

    async def answer_set(self, request, response):
        if await self.fits(request.parameters):
            self.requests.append([item.name for item in request.parameters])
            response.results = [self.set_one(item) for item in request.parameters]
        return response

    def set_one(self, message):
        if self.is_float32 and message.value.type == ParameterType.PARAMETER_DOUBLE:
            kept = message.value.double_value + self.offset
            message.value.double_value = float(np.float32(kept))
        return self.set_parameters([Parameter.from_parameter_msg(message)])[0]

    def judge(self, parameters):
        for item in parameters:
            if item.name in self.refused:
                return SetParametersResult(successful=False, reason=self.refused[item.name])
            now = self.get_parameter(item.name).value
            if item.name in self.stays and now != 0.5:
                return SetParametersResult(successful=False, reason="it stays")
            other = self.least.get(item.name)
            if other is not None and item.value < self.get_parameter(other).value:
                return SetParametersResult(successful=False, reason=f"below {other}")
        return super().judge(parameters)

    async def answer_get(self, request, response):
        if await self.fits(request.names):
            found = [self.get_parameter_or(name) for name in request.names]
            response.values = [item.get_parameter_value() for item in found]
        return response

    def answer_list(self, _request, response):
        response.result.names = list(self._parameters)
        return response

    async def answer_describe(self, request, response):
        if await self.fits(request.names):
            response.descriptors = [self.describe_parameter(name) for name in request.names]
        return response
