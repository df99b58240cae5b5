"""The first picture of the README: the motor with its default gains, and with the tuned ones.

python examples/unchanged_system/animation.py RUN docs/images/position.gif

RUN is a run of `study.yaml`, recorded with ``--record all``: its validation has both parameter sets
in the same draw.
"""

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.animation import FuncAnimation, PillowWriter

from bo_tuner.recording.signal_bag import RecordedRun, recorded_runs

FRAMES_A_SECOND = 20
LAST = 1.2
"""Time [s] for which the last picture stands."""
LOOKS = {"default": "#c2410c", "tuned": "#0f766e"}
LIMIT = 5.0
"""Of the overshoot [%]."""


def validated(run: Path) -> dict[str, RecordedRun]:
    """Return the first run of the validation of the default and of the tuned parameter set."""
    first = {}
    for recorded in recorded_runs(run / "bags" / "validation"):
        first.setdefault(recorded.trial, recorded)
    return {name: first[number] for number, name in enumerate(LOOKS)}


def draw(runs: dict[str, RecordedRun], path: Path) -> None:
    """Write the animation."""
    mpl.use("Agg")
    figure, axes = plt.subplots(figsize=(7.2, 3.2), dpi=100, layout="constrained")
    end = min(run.recording.end for run in runs.values())
    axes.axhline(1.0, color="#64748b", linewidth=1.0, linestyle="--")
    axes.axhspan(1.0 + LIMIT / 100.0, 2.0, color="#dc2626", alpha=0.08, linewidth=0.0)
    axes.text(0.99 * end, 1.0 + LIMIT / 100.0 + 0.01, "over the limit", ha="right", color="#b91c1c")
    axes.set(xlim=(0.0, end), ylim=(0.0, 1.5), xlabel="time [s]", ylabel="angle [rad]")
    axes.spines[["top", "right"]].set_visible(False)
    lines = {}
    for name, color in LOOKS.items():
        metrics = runs[name].evaluation["metrics"]
        label = (
            f"{name}: overshoot {metrics['overshoot']:.0f} %, error {metrics['error']:.2f} rad s"
        )
        (lines[name],) = axes.plot([], [], color=color, linewidth=2.2, label=label)
    axes.legend(loc="lower right", frameon=False)
    times = np.append(np.arange(0.0, end, 1.0 / FRAMES_A_SECOND), end)
    frames = [*times, *[end] * round(LAST * FRAMES_A_SECOND)]

    def show(now: float) -> list[object]:
        for name, line in lines.items():
            angle = runs[name].recording.signals["angle"]
            until = angle.time <= now
            line.set_data(angle.time[until], angle.value[until])
        return list(lines.values())

    FuncAnimation(figure, show, frames, blit=False).save(path, PillowWriter(FRAMES_A_SECOND))


if __name__ == "__main__":
    folder, target = map(Path, sys.argv[1:])
    draw(validated(folder), target)
