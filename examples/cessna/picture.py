"""Draws flights before and after tuning from the JSON file that campaign.py writes."""

import argparse
import json
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from judge import ALTITUDE, HEADING, Conditions, fly
from matplotlib.figure import Figure

COLORS = {"default": "#888888", "tuned": "#0b63a5"}
TURBULENT = Conditions(wind=12.0, airspeed=50.0, luggage=40.0, wing_load=30.0, seed=1)


def draw(judged: dict[str, dict[str, object]], tuned: str) -> Figure:
    """Return the picture: altitude, heading and controls over time, in two conditions.

    One is the worst of the default.
    """
    worst = Conditions(**judged["default"]["worst"]["conditions"])
    figure, axes = plt.subplots(4, 2, sharex=True, sharey="row", figsize=(9, 8))
    for column, conditions in enumerate((worst, TURBULENT)):
        axes[0, column].set_title(
            f"{conditions.wind:g} m/s wind, {conditions.airspeed:g} m/s, "
            f"loads {conditions.luggage:g} and {conditions.wing_load:g} kg",
            fontsize=10,
        )
        for name, key in (("default", "default"), ("tuned", tuned)):
            time, altitude, heading, aileron, elevator = fly(judged[key]["gains"], conditions).T
            curves = (altitude, np.degrees(heading), aileron, elevator)
            for axis, values in zip(axes[:, column], curves, strict=True):
                axis.plot(time, values, color=COLORS[name], label=name, linewidth=1.2)
        for axis, goal in zip(axes[:2, column], (ALTITUDE, np.degrees(HEADING)), strict=True):
            axis.axhline(goal, color="black", linewidth=0.6, linestyle="--")
        axes[-1, column].set_xlabel("time [s]")
    labels = ("altitude [m]", "heading [°]", "aileron", "elevator")
    for axis, label in zip(axes[:, 0], labels, strict=True):
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
