"""Draws flights before and after tuning from the JSON file that campaign.py writes."""

import argparse
import json
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from judge import GOAL, Conditions, fly
from matplotlib.figure import Figure

COLORS = {"default": "#888888", "tuned": "#0b63a5"}


def draw(judged: dict[str, dict[str, object]], tuned: str) -> Figure:
    """Return the picture: forward, upward and first rotor over time, calm and in the worst wind.

    The worst condition is that of the default.
    """
    worst = Conditions(**judged["default"]["worst"]["conditions"])
    columns = {
        "no wind, no payload": Conditions(seed=1),
        f"{worst.wind_speed:g} m/s wind, {1000 * worst.payload:g} g payload": worst,
    }
    figure, axes = plt.subplots(3, 2, sharex=True, sharey="row", figsize=(9, 6.5))
    for column, (title, conditions) in enumerate(columns.items()):
        axes[0, column].set_title(title)
        for name, key in (("default", "default"), ("tuned", tuned)):
            positions, speeds, _ = fly(judged[key]["gains"], conditions)
            time = 0.01 * np.arange(len(positions))
            curves = (positions[:, 0], positions[:, 2], speeds[:, 0])
            for axis, values in zip(axes[:, column], curves, strict=True):
                axis.plot(time, values, color=COLORS[name], label=name, linewidth=1.2)
        for axis, goal in zip(axes[:2, column], GOAL[[0, 2]], strict=True):
            axis.axhline(goal, color="black", linewidth=0.6, linestyle="--")
        axes[2, column].set_xlabel("time [s]")
    for axis, label in zip(axes[:, 0], ("x [m]", "z [m]", "rotor 1 [rad/s]"), strict=True):
        axis.set_ylabel(label)
    axes[0, 0].legend(loc="lower right")
    figure.tight_layout()
    return figure


def main() -> None:
    """Read, draw, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("result", type=Path, help="JSON file of campaign.py")
    parser.add_argument("output", type=Path, help="PNG or SVG file")
    parser.add_argument("--seed", type=int, default=1, help="which of the runs (default: 1)")
    arguments = parser.parse_args()
    judged = json.loads(arguments.result.read_text(encoding="utf-8"))["judged"]
    draw(judged, f"tuned, seed {arguments.seed}").savefig(arguments.output, dpi=110)


if __name__ == "__main__":
    main()
