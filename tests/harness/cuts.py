"""Cuts in this process, and controllers for them."""

from collections import defaultdict
from dataclasses import dataclass

from milling_plant.cut import MillingPlant
from mpc_controller.controller import MpcController


class Constant:
    """A controller that always commands the same, and records what it was told."""

    def __init__(self, command):
        self.command = command

    def start(self, reference):
        self.reference = reference
        self.measurements = []

    def step(self, measurement):
        self.measurements.append(measurement)
        return self


def expected_commands(velocities, reference):
    """Commands of a controller that measures velocities [m/s], in order; None was lost."""
    controller = MpcController()
    controller.start(reference)
    return [controller.skip() if v is None else controller.step(v).command for v in velocities]


class Tap:
    """Keeps what goes into and out of a controller, by sample: all velocities [m/s]."""

    def __init__(self, controller):
        self.controller = controller

    def start(self, reference):
        self.kept = defaultdict(list)
        self.controller.start(reference)

    def step(self, measurement):
        step = self.controller.step(measurement)
        self.kept["measurement"].append(measurement)
        self.kept["command"].append(step.command)
        self.kept["estimate"].append(step.estimate)
        return step


@dataclass
class TappedCut:
    """Results of plant and controller, and what passed between them (`Tap`)."""

    plant: dict
    controller: dict
    kept: dict


def cut_in_process(plant_values, controller_values):
    """Run a cut without ROS, with some parameters of both set."""
    plant, tap = MillingPlant(), Tap(MpcController())
    plant.set_parameters(plant_values)
    tap.controller.set_parameters(controller_values)
    result = plant.run_cut(tap)
    return TappedCut(result, tap.controller.cut_result(), tap.kept)
