"""A gymnasium environment of MuJoCo; the gains of a linear policy are the parameters.

Needs both: pip install 'bo_tuner[mujoco]'.
"""

import gymnasium
import numpy as np

import bo_tuner as bt

STEPS = 200

study = bt.Study(
    name="inverted_pendulum",
    parameters={
        "position": bt.Double(-2.0, 2.0, default=0.2),
        "angle": bt.Double(0.0, 20.0, default=4.0),
        "velocity": bt.Double(-2.0, 4.0, default=0.5),
        "rate": bt.Double(0.0, 5.0, default=0.5),
    },
    contexts={
        "pole_mass": bt.Uniform(bounds=(0.5, 2.0)),
        "motor": bt.Uniform(bounds=(0.7, 1.3)),
    },
    metrics={"cost": {}, "largest": {"unit": "rad"}},
    objective=bt.Objective(metric="cost", scale="log"),
    constraints={"upright": bt.Chance("largest", upper=0.03, probability=0.95)},
    budget=bt.Budget(trials=20, initial_trials=10),
)


class Balance:
    """Runs episodes in one environment, whose model a context changes.

    It is made when it is first used, in whatever process that is: an environment is not picklable.
    """

    def __init__(self):
        self.environment = None

    def __getstate__(self):
        return {"environment": None}

    def __call__(self, parameters, context, seed):
        """Balance for 8 s; returns the mean cost, and the largest angle."""
        if self.environment is None:
            self.environment = gymnasium.make("InvertedPendulum-v5").unwrapped
            self.masses = self.environment.model.body_mass.copy()
            self.gears = self.environment.model.actuator_gear.copy()
        model = self.environment.model
        pole = model.body("pole").id
        model.body_mass[pole] = self.masses[pole] * context["pole_mass"]
        model.actuator_gear[:] = self.gears * context["motor"]
        gains = np.array([parameters[name] for name in ("position", "angle", "velocity", "rate")])
        state, _ = self.environment.reset(seed=seed)
        states = [state]
        for _ in range(STEPS):
            force = np.clip(gains @ state, -3.0, 3.0)
            state, _, fell, _, _ = self.environment.step(np.array([force]))
            states.append(state)
            if fell:
                raise bt.Failed("the pole fell")
        position, angle = np.array(states)[:, :2].T
        return {
            "cost": float(np.mean(position**2 + 10.0 * angle**2)),
            "largest": float(np.abs(angle).max()),
        }


if __name__ == "__main__":
    print(study.optimize(Balance()))
