"""What is known of a study's optimum, to measure answers against."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bo_tuner.errors import StudyError
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import study_to_mapping
from tuning_benchmark.problems import closed_form, two_basins

JUDGED = ("nodes", "parameters", "contexts", "metrics", "objective", "constraints", "order")
"""Sections of a study that change the truth of a parameter set."""

SAMPLES = 400


@dataclass(frozen=True)
class Optimum:
    """The best objective of a study, and the best at each margin.

    Attributes
    ----------
    objective
        Lowest expected objective under the study's limits.
    worst, least
        Frontier: the lowest expected objective of any parameter set whose worst case is at most so
        large, by ascending worst case; empty if unknown.
    """

    objective: float
    worst: tuple[float, ...] = ()
    least: tuple[float, ...] = ()

    def at(self, worst: float) -> float | None:
        """Lowest objective at a worst case, interpolated; None beyond what is known."""
        if not self.worst or not self.worst[0] <= worst <= self.worst[-1]:
            return None
        return float(np.interp(worst, self.worst, self.least))


def optimum_of(entries: Mapping[str, Any], study: Study) -> Optimum | None:
    """Return what is known of a study: by its closed form, or by the search of a grid.

    Parameters
    ----------
    entries
        Results of `benchmarks/grid_search.py`, each with the digest of its study.
    study
        The study, under any name.

    Returns
    -------
    Optimum or None
        None if nothing is known.
    """
    objects = [node.object for node in study.nodes.values()]
    if objects == [_path(two_basins.Node)]:
        (node,) = study.nodes.values()
        return Optimum(two_basins.problem_of(node.parameters).best)
    if objects == [_path(closed_form.Node)]:
        problem = closed_form.problem_of_study(study)
        worst = np.linspace(0.0, 1.5 * closed_form.LIMIT, SAMPLES)
        return Optimum(problem.best, tuple(worst), tuple(problem.frontier(worst)))
    digest = study_digest(study)
    entry = next((entry for entry in entries.values() if entry["digest"] == digest), None)
    if entry is None:
        return None
    frontier = entry.get("frontier", [])
    return Optimum(
        float(entry["optimum"]["E"]),
        tuple(float(worst) for worst, _ in frontier),
        tuple(float(least) for _, least in frontier),
    )


def _path(node: type) -> str:
    return f"{node.__module__}:{node.__name__}"


def study_digest(study: Study) -> str:
    """Digest of what decides over the truth of a study's parameter sets.

    It leaves out the seed, the budget, what is tried first, the scale of a metric's model,
    whether it only grows, labels, and the probability of the worst-case constraint, which is on
    record with each search.
    """
    content: dict[str, Any] = dict(study_to_mapping(study))
    judged = {key: content[key] for key in JUDGED if key in content}
    ignored_keys = {"metrics": ("scale", "label", "grows"), "parameters": ("label",)}
    for section, ignored in ignored_keys.items():
        judged[section] = {
            name: {key: value for key, value in item.items() if key not in ignored}
            for name, item in content[section].items()
        }
    judged["constraints"] = {
        name: {k: v for k, v in item.items() if k != "probability" or item["kind"] != "worst_case"}
        for name, item in content.get("constraints", {}).items()
    }
    return hashlib.sha256(json.dumps(judged, sort_keys=True).encode()).hexdigest()[:16]


def read_optima(path: Path) -> dict[str, Any]:
    """Read the result file of `benchmarks/grid_search.py`.

    Raises
    ------
    StudyError
        If it cannot be read.
    """
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise StudyError(f"cannot read {path}: {error}", ("truth",)) from None
    if not isinstance(entries, dict):
        raise StudyError(f"{path}: expected an object of studies", ("truth",))
    for name, entry in entries.items():
        if not isinstance(entry, dict) or not {"digest", "optimum"} <= entry.keys():
            raise StudyError(f"{path}: {name}: expected a digest and an optimum", ("truth",))
    return entries
