"""Shows what each gain of an example does alone: each is made smaller and larger.

Flies in eight conditions, drawn as the study says, and prints a table in Markdown: the mean of each
metric. Run it from the root of the repository.
"""

import argparse
import importlib
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

FACTORS = (0.5, 2.0)
FLIGHTS = 8


def main() -> None:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("example", help="folder beside this file")
    sys.path.insert(0, str(Path(__file__).parent / parser.parse_args().example))
    judge = importlib.import_module("judge")
    sets = {"default": dict(judge.DEFAULT)}
    sets |= {
        f"{name} × {factor:g}": dict(judge.DEFAULT) | {name: factor * value}
        for name, value in judge.DEFAULT.items()
        for factor in FACTORS
    }
    conditions = judge.draws(FLIGHTS)
    with ProcessPoolExecutor() as executor:
        for name, gains in sets.items():
            flights = [vars(f) for f in executor.map(judge.judge, [gains] * FLIGHTS, conditions)]
            if name == "default":
                metrics = [metric for metric in flights[0] if metric != "crashed"]
                print("| gains |", *(f"{metric} |" for metric in metrics), "crashes |")
                print("|---|" + "---|" * (len(metrics) + 1))
            flown = [flight for flight in flights if not flight["crashed"]]
            means = (np.mean([flight[metric] for flight in flown]) for metric in metrics)
            print(f"| {name} |", *(f"{mean:.4g} |" for mean in means), FLIGHTS - len(flown), "|")


if __name__ == "__main__":
    main()
