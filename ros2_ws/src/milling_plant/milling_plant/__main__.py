"""The command ``milling_plant``."""

import sys

from feed_axis_common.signals import exit_on_stop_signal
from feed_axis_common.threads import use_one_thread


def main() -> None:
    """Run the node until SIGINT or SIGTERM."""
    exit_on_stop_signal()
    use_one_thread()

    from feed_axis_common.parameters import specifications
    from feed_axis_common.ros.process import run
    from milling_plant.node import PlantNode
    from milling_plant.settings import PlantSettings

    what = "Feed axis of a milling centre, simulated: cuts along a reference on request."
    sys.exit(run(PlantNode, what, specifications(PlantSettings)))


if __name__ == "__main__":
    main()
