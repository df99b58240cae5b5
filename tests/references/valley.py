"""The valley of `tuning_benchmark.campaign.cost`: its truth in closed form, and optimizers."""

import os
from pathlib import Path

import numpy as np

from tuning_benchmark.judging.truth import Judgement

LARGEST_LOAD = 1.2
MEAN_NOISE = 0.01 * np.sqrt(2.0 / np.pi)
"""Expectation of the magnitude of the noise on the error."""


def true_objective(gains, load=1.0):
    return 0.1 + float(np.mean((np.asarray(gains) - 0.7) ** 2)) * load + MEAN_NOISE


def true_worst(gains):
    return float(np.mean(gains)) * LARGEST_LOAD


class Judge:
    def __init__(self, constants, drawn, grid, corners, seed):
        if "valley" not in constants:
            raise ValueError("no valley")
        self.drawn, self.grid, self.corners = drawn["load"], grid["load"], corners

    def judge(self, values):
        gains = [v for name, v in sorted(values["valley"].items()) if name[0] == "g"]
        means = np.mean(gains) * self.grid
        return Judgement(
            true_objective(gains, self.drawn.mean()),
            0.0,
            float(means.max()),
            int(means.argmax()),
            np.mean(gains) * self.drawn,
        )

    def worst_runs(self, values):
        return np.array([[self.judge(values).worst]])


class NoisyJudge(Judge):
    """With runs in the worst context that are uniform around the mean, give or take 0.1."""

    def worst_runs(self, values):
        judged = self.judge(values)
        return np.vstack([judged.worst + np.linspace(-0.1, 0.1, 1001), np.full(1001, -1.0)])


class Draws:
    """Random draws; recommends the best that it saw keep all limits."""

    def __init__(self, study, seed):
        self.space = study.search_space()
        self.rng = np.random.default_rng(seed)
        self.told = []

    def ask(self):
        parameters = self.space.to_parameters(self.rng.random(self.space.dimension))
        return {name: parameters[name] for name in self.space.names}

    def tell(self, observation):
        self.told.append(observation)

    def recommend(self):
        held = [
            (seen.objective, index)
            for index, seen in enumerate(self.told)
            if not seen.failed and max(seen.constraints.values()) <= 0.0
        ]
        return min(held)[1] if held else None


class Broken(Draws):
    def ask(self):
        raise RuntimeError("out of\nideas")


class Endless(Draws):
    """Computes in compiled code, and makes the file that the environment names first.

    Not with OSQP, which takes Ctrl-C for itself while it solves.
    """

    def ask(self):
        matrix = np.random.default_rng(1).standard_normal((300, 300))
        Path(os.environ["VALLEY_ENDLESS"]).touch()
        while True:
            np.linalg.svd(matrix)


class Unsteady(Draws):
    """Cannot ask as long as the file that the environment names is there."""

    def ask(self):
        if Path(os.environ["VALLEY_UNSTEADY"]).exists():
            raise OSError("unsteady")
        return super().ask()
