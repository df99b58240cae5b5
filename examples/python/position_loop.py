"""Tune a position controller on a model: any Python function that returns numbers will do."""

import numpy as np

import bo_tuner as bt

STEP, DURATION = 0.01, 3.0  # [s]

study = bt.Study(
    name="position_loop",
    parameters={
        "kp": bt.Double(1.0, 100.0, default=20.0, scale="log", unit="V/rad"),
        "kd": bt.Double(0.1, 30.0, default=0.5, scale="log", unit="V s/rad"),
    },
    contexts={
        "inertia": bt.Uniform(bounds=(0.5, 2.0)),
        "friction": bt.Uniform(bounds=(0.5, 1.5)),
    },
    metrics={"error": {"unit": "rad"}, "overshoot": {"unit": "rad"}},
    objective="error",
    constraints={"overshoot": bt.WorstCase("overshoot", upper=0.05)},
    budget=bt.Budget(trials=16, initial_trials=8),
)


def turn(parameters, context, seed):
    """Turn a motor by 1 rad; returns the mean error and the overshoot."""
    noise = np.random.default_rng(seed).normal(0.0, 0.001, round(DURATION / STEP))
    angle, speed, angles = 0.0, 0.0, []
    for disturbance in noise:
        measured = angle + disturbance
        voltage = np.clip(parameters["kp"] * (1.0 - measured) - parameters["kd"] * speed, -24, 24)
        speed += STEP * (voltage - context["friction"] * speed) / context["inertia"]
        angle += STEP * speed
        angles.append(angle)
        if abs(angle) > 10.0:
            raise bt.Failed("the motor ran away")
    return {
        "error": float(np.mean(np.abs(1.0 - np.array(angles)))),
        "overshoot": max(max(angles) - 1.0, 0.0),
    }


if __name__ == "__main__":
    result = study.optimize(turn)
    print(result)
    certificate = result.certify(turn, runs=200)
    print(certificate.verdict)
