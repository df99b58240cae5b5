"""Tune the gains of a policy in an environment with `reset` and `step`, as Gymnasium has them."""

import numpy as np

import bo_tuner as bt


class Pole:
    """A pole on a cart that is pushed; the angle [rad] grows unless somebody balances it."""

    def reset(self, seed, options):
        """Begin an episode with a pole of this length [m]; returns the observation."""
        self.length = options["length"]
        self.state = np.random.default_rng(seed).normal(0.0, 0.05, 2)
        return self.state, {}

    def step(self, push):
        """Push for 20 ms; returns observation, reward, whether it fell or is over, and more."""
        angle, rate = self.state
        rate += 0.02 * (9.81 * np.sin(angle) - push * np.cos(angle)) / self.length
        self.state = np.array([angle + 0.02 * rate, rate])
        return self.state, -(angle**2) - 1e-4 * push**2, abs(angle) > 0.5, False, {}


def balance(parameters, context, seed):
    """Balance for 4 s; returns the cost of it and the largest angle."""
    environment = Pole()
    (angle, rate), _ = environment.reset(seed=seed, options=context)
    cost, largest = 0.0, abs(angle)
    for _ in range(200):
        push = parameters["angle_gain"] * angle + parameters["rate_gain"] * rate
        (angle, rate), reward, fell, _, _ = environment.step(push)
        cost, largest = cost - reward, max(largest, abs(angle))
        if fell:
            raise bt.Failed("the pole fell")
    return {"cost": float(cost), "largest": float(largest)}


study = bt.Study(
    name="pole",
    parameters={
        "angle_gain": bt.Double(12.0, 100.0, default=15.0),
        "rate_gain": bt.Double(0.5, 20.0, default=1.0),
    },
    contexts={"length": bt.Uniform(bounds=(0.3, 1.5))},
    metrics={"cost": {}, "largest": {"unit": "rad"}},
    objective=bt.Objective(metric="cost", scale="log"),
    constraints={"upright": bt.Chance("largest", upper=0.3, probability=0.95)},
    budget=bt.Budget(trials=16, initial_trials=8),
)

if __name__ == "__main__":
    print(study.optimize(balance))
