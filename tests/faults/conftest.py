"""Faults are put upon the same processes that tests/ros starts, by its fixtures."""

import importlib.util
import sys
from pathlib import Path

TESTS = Path(__file__).parents[1]


def load(path):
    """Import a conftest module of another folder under a name of its own."""
    name = "_".join(path.relative_to(TESTS).with_suffix("").parts)
    spec = importlib.util.spec_from_file_location(name, path)
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


ros = load(TESTS / "ros" / "conftest.py")

client = ros.client
drive = ros.drive
loop = ros.loop
make_peer = ros.make_peer
peer = ros.peer
ros_environment = ros.ros_environment
shared_controller = ros.shared_controller
shared_pair = ros.shared_pair
shared_plant = ros.shared_plant
stand_in_controller = ros.stand_in_controller
start_node = ros.start_node
start_shared_node = ros.start_shared_node
tune = ros.tune
drive_study = ros.drive_study
