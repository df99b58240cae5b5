"""Runs of the command `tune` on a small object, which are killed, resumed and compared."""

import csv
import shutil
from pathlib import Path

from axis import node, write_study
from commands import Fork, finish
from waiting import count_in

RESULTS = ("summary.json", "trials.csv", "evaluations.csv", "best.yaml", "study.yaml")


def results_of(run):
    """Return the text of each file of results, without how busy the computer was."""
    return [_results(run / file) for file in RESULTS]


def _results(path):
    if path.suffix != ".csv":
        return path.read_text()
    with path.open(newline="") as file:
        rows = csv.DictReader(file)
        return [{k: v for k, v in row.items() if not k.startswith("load.")} for row in rows]


class Runs:
    """Runs of the command on a small object; each counts its evaluations in a file of its own."""

    def __init__(self, folder, study, **expressions):
        self.folder = folder
        self.study = write_study(folder, study, **expressions)

    def start(self, name, *arguments, kill=0, hold=0):
        environment = {"CUTS": str(self._counter(name)), "KILL": str(kill), "HOLD": str(hold)}
        return Fork("tune", *arguments, folder=self.folder, env=environment)

    def go_on(self, name):
        """Let the evaluation end that is held."""
        Path(f"{self._counter(name)}.go").touch()

    def _counter(self, name):
        return self.folder / f"{name}.evaluations"

    def run(self, name, *arguments, kill=0):
        return finish(self.start(name, *arguments, kill=kill))

    def begin(self, name, *arguments, kill=0):
        new = ("--study", self.study, "--backend", "inprocess", "--output", name)
        return self.run(name, *new, *arguments, kill=kill)

    def resume(self, name, *arguments, kill=0):
        return self.run(name, "--resume", self.latest(name), *arguments, kill=kill)

    def latest(self, name):
        return self.folder / name / "latest"

    def copy(self, name, new):
        """Copy a run's folder, so that the copy may be changed."""
        shutil.copytree(self.latest(name), self.folder / new / "run")
        self.latest(new).symlink_to("run")

    def evaluations(self, name):
        return count_in(self._counter(name))

    def results(self, name):
        return results_of(self.latest(name))


def noisy_runs(folder, make_study, module):
    """Runs in a folder of an object whose error has a noise of its seed, in a module of a name."""
    study = make_study(nodes=node(module), seed_parameter={"node": "axis", "parameter": "seed"})
    error = "25 * (self.gain - 0.3) ** 2 + self.load * (1 + 0.001 * (self.seed % 100))"
    return Runs(folder, study, error=error, peak="self.load * self.gain")
