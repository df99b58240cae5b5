"""Runs of the command `tune` with several workers, on an object that waits and can be killed."""

from command_runs import results_of
from commands import Fork, finish

from bo_tuner.study.study_file import study_to_yaml

OBJECT = """\
import os
import time
from pathlib import Path

HERE = Path(__file__).parent


class Axis:
    def set_parameters(self, values):
        self.__dict__.update(values)

    def evaluate(self):
        with (HERE / "evaluations").open("a") as file:
            # The process, and where on the network it is.
            file.write(f"{os.getpid()} {os.readlink('/proc/self/ns/net')}\\n")
        # Once for each file: one worker takes it, the others do not find it.
        for order, act in (("kill", lambda: os.kill(os.getpid(), 9)),):
            try:
                (HERE / order).unlink()
            except FileNotFoundError:
                continue
            act()
        while (HERE / "hold").exists():
            time.sleep(0.01)
        # Whichever worker is the faster.
        time.sleep(os.urandom(1)[0] / 5000.0)
        return {
            "status": "ok",
            "error": 25 * (self.gain - 0.3) ** 2 + self.load * (1 + 0.001 * (self.seed % 100)),
            "peak": self.load * self.gain,
        }
"""


class Runs:
    """Runs of commands in a folder with the object."""

    def __init__(self, folder, study):
        self.folder = folder
        (folder / "waiting_axis.py").write_text(OBJECT)
        (folder / "axis.yaml").write_text(study_to_yaml(study))

    @property
    def evaluations(self):
        return self.folder / "evaluations"

    @property
    def places(self):
        """Process and network of each evaluation so far."""
        text = self.evaluations.read_text() if self.evaluations.exists() else ""
        return [tuple(line.split()) for line in text.splitlines()]

    def latest(self, name):
        return self.folder / name / "latest"

    def start(self, *arguments, **options):
        return Fork(*arguments, folder=self.folder, **options)

    def begin(self, name, *arguments, **options):
        new = ("--study", "axis.yaml", "--backend", "inprocess", "--output", name)
        return self.start("tune", *new, *arguments, **options)

    def run(self, name, *arguments):
        code, _, err = finish(self.begin(name, *arguments))
        assert code == 0, err
        return self.results(name)

    def results(self, name):
        return results_of(self.latest(name))


def waiting_study(make_study):
    """The study of the object."""
    node = {"node": "axis", "result": "~/cut_result", "object": "waiting_axis:Axis"}
    return make_study(
        nodes={"axis": node}, seed_parameter={"node": "axis", "parameter": "seed"}
    ).replace(trials=6)
