"""A node of the test that talks to others."""

import time

from waiting import DEADLINE


class Peer:
    """A node of the test with its own context and executor."""

    def __init__(self, namespace=""):
        import rclpy
        from rclpy.executors import SingleThreadedExecutor

        self.context = rclpy.Context()
        rclpy.init(args=[], context=self.context)
        self.node = rclpy.create_node("peer", namespace=namespace, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self._clients = {}

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def spin_until(self, condition, what, timeout=DEADLINE):
        """Handle what comes until the condition holds."""
        assert self._spin(condition, timeout), f"waited {timeout} s for {what}"

    def _spin(self, condition, timeout):
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                return False
            self.executor.spin_once(timeout_sec=0.02)
        return True

    def spin_for(self, duration):
        """Handle what comes for a while, to see that something does not come."""
        self._spin(lambda: False, duration)

    def call(self, service, name, request):
        """Call a service and return its answer.

        A server may take a request before it has discovered where the answer goes, which is then
        lost: what stays unanswered is asked again. Of a service that acts, its node is met before
        the first call.
        """
        if name not in self._clients:
            self._clients[name] = self.node.create_client(service, name)
            node, _, last = name.rpartition("/")
            if not last.endswith("_parameters") and self.node.count_services(
                f"{node}/get_parameters"
            ):
                self.meet(node)
        client = self._clients[name]
        self.spin_until(client.service_is_ready, f"service {name}")
        futures = []
        while len(futures) < 20:
            futures.append(client.call_async(request))
            # A late answer to an earlier request is as good.
            if self._spin(lambda: any(f.done() for f in futures), DEADLINE / 60):
                answered = next(f for f in futures if f.done())
                for future in futures:
                    client.remove_pending_request(future)
                return answered.result()
        raise AssertionError(f"no answer of {name}")

    def trigger(self, name):
        from std_srvs.srv import Trigger

        return self.call(Trigger, name, Trigger.Request())

    def record(self, message, topic):
        """List that fills with the messages of a topic."""
        received = []
        # Deep, so that a test that is busy elsewhere loses nothing.
        self.node.create_subscription(message, topic, received.append, 10_000)
        return received

    def meet(self, node):
        """Wait until a node sends here whatever this one has subscribed to so far.

        It hears of the ends of this node in the order of their making. So one that answers a new
        client knows all earlier subscriptions; that publishers are seen here does not tell.
        """
        client = self._clients.pop(f"{node}/get_parameters", None)
        if client is not None:
            self.node.destroy_client(client)
        self.get_parameters(node, ["use_sim_time"])

    def set_parameters(self, node, values):
        """Set parameters atomically; returns the result message."""
        from rcl_interfaces.srv import SetParametersAtomically
        from rclpy.parameter import Parameter

        parameters = [
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
        ]
        request = SetParametersAtomically.Request(parameters=parameters)
        return self.call(
            SetParametersAtomically, f"{node}/set_parameters_atomically", request
        ).result

    def get_parameters(self, node, names):
        from rcl_interfaces.srv import GetParameters
        from rclpy.parameter import parameter_value_to_python

        answer = self.call(
            GetParameters, f"{node}/get_parameters", GetParameters.Request(names=list(names))
        )
        return [parameter_value_to_python(value) for value in answer.values]
