"""The hot plate as a ROS 2 node that can be tuned."""

import signal

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from hot_plate import DEFAULTS, HotPlate
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger


class HotPlateNode(Node):
    """Parameters, a service that starts a run, and a topic with the metrics of each run."""

    def __init__(self) -> None:
        super().__init__("hot_plate")
        self._plate = HotPlate()
        self._run_id = ""
        # Before the declarations, so that values of the command line are judged as well.
        self.add_on_set_parameters_callback(self._judge)
        for name, value in DEFAULTS.items():
            self.declare_parameter(name, value)
        self._result = self.create_publisher(DiagnosticArray, "~/run_result", 10)
        self.create_service(Trigger, "~/run", self._on_run)
        self._timer = self.create_timer(0.001, self._run)
        self._timer.cancel()

    def _judge(self, parameters: list[Parameter]) -> SetParametersResult:
        values = {p.name: p.value for p in parameters if p.name in DEFAULTS}
        try:
            HotPlate().set_parameters(values)
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _on_run(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._run_id:
            response.message = f"run {self._run_id} is not over"
            return response
        self._run_id = str(self.get_clock().now().nanoseconds)
        # The answer goes out at once, and the run begins after it.
        self._timer.reset()
        response.success, response.message = True, self._run_id
        return response

    def _run(self) -> None:
        # A machine would go on for minutes here, step by step; the simulation is done at once.
        self._timer.cancel()
        self._plate.set_parameters({name: self.get_parameter(name).value for name in DEFAULTS})
        values = {"cut": self._run_id} | self._plate.evaluate()
        failed = values["status"] != "ok"
        status = DiagnosticStatus(
            name="hot_plate: run_result",
            level=DiagnosticStatus.ERROR if failed else DiagnosticStatus.OK,
            message=str(values.get("reason", "")),
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._run_id = ""
        self._result.publish(message)


def main() -> None:
    """Run the node until Ctrl-C or SIGTERM."""
    signals: list[int] = []
    for signum in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signum, lambda signum, _frame: signals.append(signum))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = HotPlateNode()
    node.get_logger().info("ready")
    while not signals:
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
