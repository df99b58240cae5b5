"""The command ``mpc_controller``."""

import sys

from feed_axis_common.signals import exit_on_stop_signal
from feed_axis_common.threads import use_one_thread


def main() -> None:
    """Run the node until SIGINT or SIGTERM."""
    exit_on_stop_signal()
    use_one_thread()

    from feed_axis_common.parameters import specifications
    from feed_axis_common.ros.process import run
    from mpc_controller.node import ControllerNode
    from mpc_controller.settings import ControllerSettings

    what = "Kalman filter and model predictive controller of a feed axis."
    sys.exit(run(ControllerNode, what, specifications(ControllerSettings)))


if __name__ == "__main__":
    main()
