"""A model of another tool, as an FMU: its parameters are what is tuned and what is uncertain.

Needs FMPy: pip install 'bo_tuner[fmu]'. Any FMU will do that has the names of the study as start
values; here it is a tank with a level controller, which pythonfmu makes of `tank_slave.py`:

    pip install pythonfmu
    pythonfmu build -f examples/python/tank_slave.py
    python examples/python/fmu.py Tank.fmu
"""

import sys

import fmpy
import numpy as np

import bo_tuner as bt

study = bt.Study(
    name="tank",
    parameters={
        "kp": bt.Double(0.05, 5.0, default=0.5, scale="log"),
        "ki": bt.Double(0.002, 0.5, default=0.05, scale="log", unit="1/s"),
    },
    contexts={"area": bt.Uniform(bounds=(0.5, 1.5)), "outflow": bt.Uniform(bounds=(0.05, 0.15))},
    metrics={"error": {"unit": "m"}, "overshoot": {"unit": "m"}},
    objective="error",
    constraints={"no_spill": bt.WorstCase("overshoot", upper=0.05)},
    budget=bt.Budget(trials=16, initial_trials=8),
)


class Simulation:
    """Simulates an FMU from start to end; the values of a run are its start values."""

    def __init__(self, path):
        # Read and unpacked once, and not for each run.
        self.description = fmpy.read_model_description(path)
        self.folder = fmpy.extract(path)

    def __call__(self, parameters, context, seed):
        """Return the mean error of the level, and how far it went beyond 1 m."""
        try:
            found = fmpy.simulate_fmu(
                self.folder,
                model_description=self.description,
                start_values={**parameters, **context},
                output=["level"],
                stop_time=60.0,
                output_interval=0.1,
            )
        except fmpy.fmi1.FMICallException as error:
            raise bt.Failed(str(error)) from error
        level = found["level"]
        return {
            "error": float(np.mean(np.abs(1.0 - level))),
            "overshoot": max(float(level.max()) - 1.0, 0.0),
        }


if __name__ == "__main__":
    print(study.optimize(Simulation(sys.argv[1])))
