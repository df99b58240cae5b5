"""Judges sets of gains of an example, all in the same conditions."""

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

WORST, REPEATS = 3, 5
"""How many of the worst conditions of the grid are flown again, and how often with fresh noise."""


@dataclass(frozen=True)
class Comparison:
    """The judge.

    Attributes
    ----------
    judge : callable
        From gains and conditions to what became of a flight: a number for each metric, `crashed`.
    grid, draws : list
        Conditions for the worst case and for the expected values.
    study : mapping
        Objective and limits.
    executor
        Flies.
    """

    judge: Callable[[Mapping[str, float], Any], Any]
    grid: list[Any]
    draws: list[Any]
    study: Mapping[str, Any]
    executor: Executor

    def limits(self, kind: str) -> dict[str, Mapping[str, Any]]:
        """Return the constraints of a kind by the name of their metric."""
        return {c["metric"]: c for c in self.study["constraints"].values() if c["kind"] == kind}

    def fly(self, gains: Mapping[str, float], conditions: list[Any]) -> list[Any]:
        """Return what became of a flight in each of the conditions."""
        return list(
            self.executor.map(self.judge, [gains] * len(conditions), conditions, chunksize=4)
        )

    def __call__(self, gains: Mapping[str, float]) -> dict[str, Any]:
        """Judge gains: crashes, means of flights that did not crash, limits."""
        drawn, over_grid = self.fly(gains, self.draws), self.fly(gains, self.grid)
        found: dict[str, Any] = {
            "gains": dict(gains),
            "flights": len(drawn) + len(over_grid),
            "crashes": sum(flight.crashed for flight in drawn + over_grid),
        }
        if not all(flight.crashed for flight in drawn):
            found[self.study["objective"]["metric"]] = self.mean_objective(drawn)
        for metric, share in self.within(drawn).items():
            found[f"{metric}_within"] = share
        for metric in self.limits("worst_case"):
            found["worst"] = self.worst(gains, metric, over_grid)
        return found

    def mean_objective(self, flights: list[Any]) -> float:
        """Return the mean objective of the flights that did not crash."""
        metric = self.study["objective"]["metric"]
        return float(np.mean([getattr(f, metric) for f in flights if not f.crashed]))

    def within(self, flights: list[Any]) -> dict[str, float]:
        """Return the share of flights within each chance limit, by metric; a crash is not."""
        return {
            metric: float(
                np.mean([not f.crashed and getattr(f, metric) <= limit["upper"] for f in flights])
            )
            for metric, limit in self.limits("chance").items()
        }

    def excess(self, drawn: list[Any], hard: list[Any]) -> float:
        """Return by how much flights break limits, relative to these: 0 if they keep all."""
        if any(flight.crashed for flight in drawn + hard):
            return float("inf")
        within, total = self.within(drawn), 0.0
        for metric, limit in self.limits("worst_case").items():
            largest = max(getattr(flight, metric) for flight in drawn + hard)
            total += max(largest / limit["upper"] - 1.0, 0.0)
        for metric, limit in self.limits("chance").items():
            if within[metric] < limit["probability"]:
                total += max(getattr(flight, metric) for flight in drawn) / limit["upper"] - 1.0
        return total

    def worst(
        self, gains: Mapping[str, float], metric: str, over_grid: list[Any]
    ) -> dict[str, Any]:
        """Return the worst mean of a metric, and where: a crash counts as worse than any number."""
        values = np.array([np.inf if f.crashed else getattr(f, metric) for f in over_grid])
        means = []
        for k in np.argsort(-values, kind="stable")[:WORST]:
            repeats = [replace(self.grid[k], seed=20_000 + i) for i in range(REPEATS)]
            again = self.fly(gains, repeats)
            if values[k] == np.inf or any(flight.crashed for flight in again):
                return {"mean": None, "conditions": vars(self.grid[k])}
            means.append((float(np.mean([getattr(f, metric) for f in again])), int(k)))
        mean, k = max(means)
        return {"mean": mean, "conditions": vars(self.grid[k]), "single": float(values.max())}


def table(judged: Mapping[str, Mapping[str, Any]], study: Mapping[str, Any]) -> str:
    """Return the comparison as a table in Markdown.

    Sets of gains that differ in their seed (`NAME, seed 1`) share a row, with the range over them.
    """
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for name, found in judged.items():
        groups.setdefault(name.partition(", seed ")[0], []).append(found)
    header, rows = _columns(study), []
    for name, members in groups.items():
        many = f"{name}, {len(members)} seeds" if len(members) > 1 else name
        rows.append([many, *_cells(members, judged["default"], study)])
    return _markdown(["gains", *header], rows)


def seeds_table(
    runs: list[Mapping[str, Any]], judged: Mapping[str, Mapping[str, Any]], study: Mapping[str, Any]
) -> str:
    """Return a row for each run of the tuner, as a table in Markdown."""
    rows = [
        [
            str(run["seed"]), str(run["evaluations"]), run["certificate"],
            *_cells([judged[f"tuned, seed {run['seed']}"]], judged["default"], study),
        ]
        for run in runs
    ]  # fmt: skip
    return _markdown(["seed", "flights", "certificate", *_columns(study)], rows)


def _columns(study: Mapping[str, Any]) -> list[str]:
    worst, chance = _limits(study)
    return [
        f"mean {study['objective']['metric']}", "to the default",
        f"worst {worst['metric']} (limit {worst['upper']:g})",
        *(f"{c['metric']} within {c['upper']:g} (at least {c['probability']:.0%})" for c in chance),
        "crashes", "keeps all limits",
    ]  # fmt: skip


def _cells(
    members: list[Mapping[str, Any]], default: Mapping[str, Any], study: Mapping[str, Any]
) -> list[str]:
    objective, (worst, chance) = study["objective"]["metric"], _limits(study)
    means = np.array([found[objective] for found in members if objective in found])
    reached = [found["worst"]["mean"] for found in members]
    shares = {c["metric"]: min(f[f"{c['metric']}_within"] for f in members) for c in chance}
    kept = [
        value is not None
        and value <= worst["upper"]
        and all(f[f"{c['metric']}_within"] >= c["probability"] for c in chance)
        for f, value in zip(members, reached, strict=True)
    ]
    return [
        _range(means, "{:.3f}"),
        _range(means / default[objective] - 1.0, "{:+.1%}"),
        "crash" if None in reached else f"{max(reached):.1f}",
        *(f"{share:.0%}" for share in shares.values()),
        f"{sum(f['crashes'] for f in members)} of {sum(f['flights'] for f in members)}",
        f"{sum(kept)} of {len(kept)}" if len(kept) > 1 else "yes" if kept[0] else "no",
    ]


def _limits(study: Mapping[str, Any]) -> tuple[Mapping[str, Any], list[Mapping[str, Any]]]:
    constraints = study["constraints"].values()
    (worst,) = (c for c in constraints if c["kind"] == "worst_case")
    return worst, [c for c in constraints if c["kind"] == "chance"]


def _range(values: NDArray[np.float64], form: str) -> str:
    """Return the mean, and the range if there is one."""
    if not len(values):
        return ""
    mean = form.format(values.mean())
    if len(values) == 1:
        return mean
    return f"{mean} ({form.format(values.min())} to {form.format(values.max())})"


def _markdown(header: list[str], rows: list[list[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
