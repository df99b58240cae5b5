"""An object for studies that run in process, as text of a module that the study can name.

Its parameter `gain` is tuned, its context is `load`. What it does in its n-th run is told by the
environment, so that a command in a process of its own does it, too:

CUTS    file in which it counts its runs, those of earlier processes included
PACE    how long a run takes [s]
KILL    the run in which the process kills itself
HOLD    the run that goes on only when the file ``$CUTS.go`` is there
FAILING runs whose seed modulo 1000 is below this fail
PEAK    the metric peak without noise
"""

from bo_tuner.study.study_file import study_to_yaml

TEXT = """\
import os
import time
from math import nextafter
from pathlib import Path


def number(name, default=0.0):
    return float(os.environ.get(name, default))


class Axis:
    drift = False
    reason = "stalled [/x] for good"

    def set_parameters(self, values):
        self.__dict__.update(values)

    def evaluate(self):
        self.count()
        time.sleep(number("PACE"))
        if {fails}:
            return {{"status": "failed", "reason": Axis.reason}}
        error = {error}
        return {{
            "status": "ok",
            "error": nextafter(error, 9.0) if Axis.drift else error,
            "peak": {peak},
        }}

    def count(self):
        if "CUTS" not in os.environ:
            return
        counter = Path(os.environ["CUTS"])
        run = int(counter.read_text()) + 1 if counter.exists() else 1
        # In one piece, for a test that looks on.
        new = counter.with_suffix(".new")
        new.write_text(str(run))
        new.replace(counter)
        if run == number("KILL"):
            os.kill(os.getpid(), 9)
        while run == number("HOLD") and not Path(f"{{counter}}.go").exists():
            time.sleep(0.01)
"""

VALLEY = "25 * (self.gain - 0.3) ** 2 + self.load"


def write_axis(
    folder,
    module="axis_objects",
    *,
    error=VALLEY,
    peak='number("PEAK", 0.2)',
    fails='self.seed % 1000 < number("FAILING")',
):
    """Write the module with the class ``Axis``; its metrics are expressions of its parameters."""
    text = TEXT.format(error=error, peak=peak, fails=fails)
    (folder / f"{module}.py").write_text(text, encoding="utf-8")


def write_study(folder, study, **expressions):
    """Write a study into ``axis.yaml``, and the module of its object beside it."""
    module = study.nodes["axis"].object.partition(":")[0]
    write_axis(folder, module, **expressions)
    file = folder / "axis.yaml"
    file.write_text(study_to_yaml(study), encoding="utf-8")
    return file


def node(module="axis_objects"):
    """Section `nodes` of a study whose one node is the object."""
    return {"axis": {"node": "axis", "result": "~/cut_result", "object": f"{module}:Axis"}}
