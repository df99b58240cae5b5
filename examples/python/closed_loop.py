"""A closed loop of python-control as the function: what is uncertain in the plant is its context.

Needs python-control: pip install 'bo_tuner[control]'.
"""

import control
import numpy as np

import bo_tuner as bt

TIME = np.linspace(0.0, 10.0, 501)  # [s]

study = bt.Study(
    name="closed_loop",
    parameters={
        "kp": bt.Double(0.1, 20.0, default=2.0, scale="log"),
        "ki": bt.Double(0.05, 10.0, default=1.0, scale="log", unit="1/s"),
    },
    contexts={
        "gain": bt.Uniform(bounds=(0.7, 1.4)),
        "delay": bt.Uniform(bounds=(0.05, 0.25)),
    },
    metrics={"error": {"unit": "s"}, "overshoot": {"unit": "%"}, "peak_sensitivity": {}},
    objective="error",
    constraints={
        "overshoot": bt.WorstCase("overshoot", upper=10.0),
        "robust": bt.WorstCase("peak_sensitivity", upper=1.8),
    },
    budget=bt.Budget(trials=20, initial_trials=8),
)


def step(parameters, context, seed):
    """Step of a lag of second order with a dead time, under a PI controller; without noise."""
    controller = control.tf([parameters["kp"], parameters["ki"]], [1.0, 0.0])
    dead_time = control.tf(*control.pade(context["delay"], 3))
    loop = controller * control.tf([context["gain"]], [0.5, 1.5, 1.0]) * dead_time
    closed = control.feedback(loop)
    if np.any(closed.poles().real >= 0.0):
        raise bt.Failed("unstable")
    response = control.step_response(closed, TIME)
    frequencies = np.logspace(-2.0, 2.0, 500)
    sensitivity = np.abs(1.0 / (1.0 + loop(1j * frequencies)))
    return {
        "error": float(np.trapezoid(np.abs(1.0 - response.outputs), TIME)),
        "overshoot": max(float(response.outputs.max()) - 1.0, 0.0) * 100.0,
        "peak_sensitivity": float(sensitivity.max()),
    }


if __name__ == "__main__":
    result = study.optimize(step)
    print(result)
    print(result.certify(step, runs=200).verdict)
