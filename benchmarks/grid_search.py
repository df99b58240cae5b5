"""Find the true optimum of the studies by dense search.

A point is judged by the truth that campaigns judge by, too. With two tuned parameters the grid is
complete (all integers, steps of 0.05). With more it is coarse, and the best points are refined by a
pattern search over integer steps and halving steps of the doubles. That a controller is too slow or
fails does not show in the vectorized loop, so that the best points also make cuts on the objects.

First every point of the grid is screened by the corners of the context box, where most infeasible
ones show, and by few drawn contexts. What keeps the limit there and costs little more than the best
is judged in full.

An optimum is narrow by the rule of `tuning_benchmark.judging.neighbours`, here for steps of the
integers. The best one that is not narrow is given too. The search is for the limit on the mean over
noise; its entry has a digest of the study that it was made for, and the frontier: the lowest E at
each worst case, as far as the screened points show it.

On two cores: about two minutes for `benchmark` and seven for `full`.
"""

import argparse
import itertools
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from common import BENCHMARKS, provenance, read_result, table, write_result
from threadpoolctl import threadpool_limits

from bo_tuner.study.parameter import Parameter
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import load_study, study_from_mapping, study_to_mapping
from bo_tuner.trials import Value
from feed_axis_common.errors import FeedAxisError
from tuning_benchmark.experiments.optima import study_digest
from tuning_benchmark.judging.neighbours import is_tolerable
from tuning_benchmark.judging.truth import SEED, Effort, Truth

OPTIMA = BENCHMARKS.parent / "ros2_ws/src/tuning_benchmark/config/experiments/grid_search.json"
JUDGE = "tuning_benchmark.milling.judge:Judge"
EFFORT = Effort(real_evaluations=50)
FINE_STEP = 0.05
COARSE_STEPS = 12
"""Intervals of a double's range on the coarse grid."""

DENSE_UP_TO = 6
GROWTH = 1.22
"""On the coarse grid integers come all up to `DENSE_UP_TO`, then about by this factor."""

SCREENED_OUT = 1.15
"""A point of the grid with a rough E above the best times this is not judged in full."""

CLOSE = 1.005
"""So is a step of the refinement, with regard to where it starts."""

STARTS = 10
"""So many points are refined."""

REPORTED = 10

Point = tuple[Value, ...]


@dataclass(frozen=True)
class Score:
    """A point's place in the search: `cost` is infinite where it is infeasible."""

    cost: float
    worst: float

    @property
    def feasible(self) -> bool:
        """Whether the point meets the overshoot limit."""
        return bool(np.isfinite(self.cost))


class GridSearch:
    """Scores of points of one study, each computed once.

    Parameters
    ----------
    study
        The study.
    pool
        Processes that were given the study by `_start_worker`.
    """

    def __init__(self, study: Study, pool: ProcessPoolExecutor) -> None:
        self.study = study
        self._pool = pool
        self._space = study.search_space()
        self._known: dict[Point, Score] = {}
        self._rough: dict[Point, tuple[float, float]] = {}
        self._narrow: dict[Point, bool] = {}

    def frontier(self) -> list[tuple[float, float]]:
        """Worst cases, ascending, and the lowest E at most so large a worst case was found with.

        Only where both improve on each other; a coarse grid shows it coarsely.
        """
        found: list[tuple[float, float]] = []
        for score in sorted(self._known.values(), key=lambda s: (s.worst, s.cost)):
            if score.feasible and (not found or score.cost < found[-1][1]):
                found.append((score.worst, score.cost))
        return found

    @property
    def size(self) -> int:
        """Number of points scored so far."""
        return len(self._known)

    def scores(self, points: Iterable[Point]) -> list[Score]:
        """Score points."""
        points = list(points)
        new = list(dict.fromkeys(p for p in points if p not in self._known))
        found = self._pool.map(_score, new, chunksize=max(1, min(16, len(new) // 8)))
        self._known |= zip(new, found, strict=True)
        return [self._known[p] for p in points]

    def screen(self, points: Sequence[Point], most: float | None = None) -> list[Point]:
        """Points worth a full judgement: corners within the limit, a rough E of at most `most`.

        Without `most` it is `SCREENED_OUT` times the lowest rough E.
        """
        new = [p for p in points if p not in self._rough]
        chunk = max(1, min(16, len(new) // 8))
        self._rough |= zip(new, self._pool.map(_rough, new, chunksize=chunk), strict=True)
        limit = self.study.constraints["overshoot"].upper
        E = [cost if worst <= limit else np.inf for cost, worst in (self._rough[p] for p in points)]
        if most is None:
            most = SCREENED_OUT * min(E)
        return [p for p, cost in zip(points, E, strict=True) if np.isfinite(cost) and cost <= most]

    def by_cost(self) -> list[Point]:
        """Feasible points scored so far, the best first."""
        feasible = [p for p, score in self._known.items() if score.feasible]
        return sorted(feasible, key=lambda p: self._known[p].cost)

    def cost(self, points: Sequence[Point]) -> list[float]:
        """E of feasible points, infinity of others."""
        return [score.cost for score in self.scores(points)]

    def cost_if_not_narrow(self, points: Sequence[Point]) -> list[float]:
        """E of points that are feasible and not narrow, infinity of others."""
        return [
            score.cost if score.feasible and not self.narrow(point) else np.inf
            for point, score in zip(points, self.scores(points), strict=True)
        ]

    def narrow(self, point: Point) -> bool:
        """Whether an integer neighbour of a feasible point is much worse."""
        if point not in self._narrow:
            names = self._space.names
            steps = self._space.integer_neighbours(dict(zip(names, point, strict=True)))
            around = [tuple(step[name] for name in names) for step in steps]
            found = self._pool.map(_judge_short, around)
            E = self._known[point].cost
            self._narrow[point] = not all(
                is_tolerable(self.study, E, cost, worst) for cost, worst in found
            )
        return self._narrow[point]

    def refine(
        self, start: Point, cost: Callable[[Sequence[Point]], list[float]], step: float
    ) -> None:
        """Walk from a point to better neighbours, steps of doubles halving down to 0.05."""
        best, (best_cost,) = start, cost([start])
        while step >= FINE_STEP / 2:
            self.screen([best])
            around = self.screen(self._steps(best, step), CLOSE * self._rough[best][0])
            costs = cost(around)
            if min(costs, default=np.inf) < best_cost:
                best_cost = min(costs)
                best = around[costs.index(best_cost)]
            else:
                step /= 2

    def _steps(self, point: Point, step: float) -> list[Point]:
        tuned = [self.study.parameters[name] for name in self._space.names]
        moves = []
        for column, parameter in enumerate(tuned):
            size = 1 if parameter.is_integer else step
            for sign in (-1, 1):
                moved = list(point)
                moved[column] = _in_bounds(parameter, point[column] + sign * size)
                moves.append(tuple(moved))
        integers = [i for i, parameter in enumerate(tuned) if parameter.is_integer]
        for sign in (-1, 1):
            # Along the diagonal too: with ordered horizons a single step may be barred.
            moved = list(point)
            for column in integers:
                moved[column] = _in_bounds(tuned[column], point[column] + sign)
            moves.append(tuple(moved))
        return [p for p in dict.fromkeys(moves) if p != point and _ordered(self.study, p)]


def coarse_axis(parameter: Parameter, complete: bool) -> list[Value]:
    """Grid values of a tuned parameter."""
    low, high = parameter.bounds or (0.0, 0.0)
    if parameter.is_integer:
        values = list(range(int(low), int(high) + 1))
        if complete:
            return list(values)
        chosen = [v for v in values if v <= DENSE_UP_TO or v in (values[0], values[-1])]
        last = float(max(DENSE_UP_TO, values[0]))
        for v in values:
            if v > DENSE_UP_TO and v >= GROWTH * last:
                chosen.append(v)
                last = v
        return sorted(set(chosen))
    steps = round((high - low) / FINE_STEP) if complete else COARSE_STEPS
    return [round(float(v), 6) for v in np.linspace(low, high, steps + 1)]


def on_the_mean(study: Study) -> Study:
    """Return a study whose worst-case limits are on the mean over noise."""
    content: dict[str, Any] = study_to_mapping(study)
    for constraint in content["constraints"].values():
        if constraint["kind"] == "worst_case":
            constraint.pop("probability", None)
    return study_from_mapping(content)


def search(study: Study, jobs: int, starts: int) -> dict[str, Any]:
    """Search a study; returns its entry of the result file."""
    begin = time.monotonic()
    study = on_the_mean(study)
    names = study.search_space().names
    tuned = [study.parameters[name] for name in names]
    complete = len(tuned) <= 2
    axes = [coarse_axis(parameter, complete) for parameter in tuned]
    grid = [point for point in itertools.product(*axes) if _ordered(study, point)]
    with ProcessPoolExecutor(jobs, initializer=_start_worker, initargs=(study,)) as pool:
        work = GridSearch(study, pool)
        work.scores(work.screen(grid))
        if not work.by_cost():
            raise SystemExit(f"error: no point of {study.name}'s grid is feasible")
        if not complete:
            first = max((a[1] - a[0]) / 2 for a in axes if isinstance(a[0], float))
            for start in _spread(work.by_cost(), starts):
                work.refine(start, work.cost, first)
        best = _confirmed(work.by_cost(), pool)
        broad = (point for point in work.by_cost() if not work.narrow(point))
        broad_starts = list(itertools.islice(broad, 1 if complete else 4))
        if not complete:
            for start in broad_starts:
                work.refine(start, work.cost_if_not_narrow, first)
            broad_starts = [p for p in work.by_cost() if work.narrow(p) is False]
        best_broad = _confirmed(broad_starts, pool, 1)
        default = tuple(study.search_space().defaults[name] for name in names)
        (default_entry,) = pool.map(_judge_fully, [default])
        for entry in best:
            entry["narrow"] = work.narrow(tuple(entry["point"]))
    return {
        "names": list(names),
        "grid": dict(zip(names, axes, strict=True)),
        "points": len(grid),
        "points_judged": work.size,
        "optimum": best[0],
        "best_not_narrow": best_broad[0] if best_broad else None,
        "next_best": best[1:],
        "digest": study_digest(study),
        "statistic": "expectation",
        "frontier": work.frontier(),
        "default": default_entry,
        "seconds": round(time.monotonic() - begin, 1),
    }


def _confirmed(
    points: Sequence[Point], pool: ProcessPoolExecutor, count: int = REPORTED
) -> list[dict[str, Any]]:
    """Judge points in order until `count` of them also meet the chance constraints."""
    found: list[dict[str, Any]] = []
    for begin in range(0, len(points), count):
        if len(found) >= count or begin >= 20 * count:
            break
        for entry in pool.map(_judge_fully, points[begin : begin + count]):
            if entry["feasible"]:
                found.append(entry)
    return found[:count]


def _spread(points: Sequence[Point], count: int) -> list[Point]:
    """Take the best points, at most two with the same integers."""
    taken: dict[tuple[int, ...], int] = {}
    chosen = []
    for point in points:
        key = tuple(v for v in point if isinstance(v, int))
        taken[key] = taken.get(key, 0) + 1
        if taken[key] <= 2:
            chosen.append(point)
        if len(chosen) == count:
            break
    return chosen


def _in_bounds(parameter: Parameter, value: Value) -> Value:
    low, high = parameter.bounds or (value, value)
    if parameter.is_integer:
        return int(min(max(value, low), high))
    return round(float(min(max(value, low), high)), 6)


def _ordered(study: Study, point: Point) -> bool:
    values = dict(zip(study.search_space().names, point, strict=True))
    return all(
        values[small] <= values[large]
        for small, large in study.order
        if small in values and large in values
    )


_worker: dict[str, Truth] = {}


def _start_worker(study: Study) -> None:
    threadpool_limits(1)
    _worker["truth"] = Truth(study, JUDGE, EFFORT)


def _complete(point: Point) -> dict[str, Value]:
    space = _worker["truth"].study.search_space()
    # Through the cube and back, which adds what is tied and fixed, without its rounding errors.
    tuned = dict(zip(space.names, point, strict=True))
    return dict(space.to_parameters(space.to_cube(tuned))) | tuned


def _values(point: Point) -> dict[str, dict[str, Value]]:
    return _worker["truth"].study.assignments(_complete(point), {}, 0)


def _score(point: Point) -> Score:
    """Score a point: E only if no context of the grid violates the limit, corners first."""
    truth, values = _worker["truth"], _values(point)
    try:
        corner = truth.judge.corner_overshoot(values)
        if not corner <= truth.limit:
            return Score(np.inf, corner)
        worst = float(truth.judge.grid_overshoot(values).max())
        if not worst <= truth.limit:
            return Score(np.inf, worst)
        return Score(float(np.mean(truth.judge.drawn(values)[0])), worst)
    except FeedAxisError:
        return Score(np.inf, np.inf)


def _rough(point: Point) -> tuple[float, float]:
    try:
        rough: tuple[float, float] = _worker["truth"].judge.rough(_values(point))
    except FeedAxisError:
        return np.inf, np.inf
    return rough


def _judge_short(point: Point) -> tuple[float, float]:
    judge, values = _worker["truth"].judge, _values(point)
    try:
        return float(np.mean(judge.drawn(values)[0])), judge.corner_overshoot(values)
    except FeedAxisError:
        return np.inf, np.inf


def _judge_fully(point: Point) -> dict[str, Any]:
    truth, parameters = _worker["truth"], _complete(point)
    verdict = asdict(truth.verdict(parameters))
    return {
        "point": list(point),
        "parameters": parameters,
        "E": verdict.pop("objective"),
        **verdict,
        "worst_precise": truth.judge.precise_worst(_values(point)),
    }


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--study",
        action="append",
        metavar="NAME|FILE",
        help="study to search; may be repeated (default: benchmark and full)",
    )
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: %(default)s)")
    parser.add_argument(
        "--starts", type=int, default=STARTS, help="points to refine (default: %(default)s)"
    )
    parser.add_argument(
        "--output",
        type=Path,
        default=OPTIMA,
        help="result file; entries of other studies in it stay (default: %(default)s)",
    )
    arguments = parser.parse_args()
    about = provenance() | {"effort": asdict(EFFORT), "truth_seed": SEED}
    entries = read_result(arguments.output) or {}
    for name in arguments.study or ["benchmark", "full"]:
        study = load_study(name)
        entry = search(study, arguments.jobs, arguments.starts)
        entries[study.name] = entry | {"provenance": about}
        write_result(arguments.output, entries)
        judged, seconds = entry["points_judged"], entry["seconds"]
        print(f"\n{study.name}: {entry['points']} points, {judged} judged, in {seconds} s")
        rows = [("optimum", entry["optimum"]), ("not narrow", entry["best_not_narrow"])]
        rows += [("default", entry["default"])]
        rows += [("next", other) for other in entry["next_best"]]
        print(_table(study, rows))


def _table(study: Study, rows: Sequence[tuple[str, dict[str, Any] | None]]) -> str:
    names = study.search_space().names
    header = ["", *names, "E", "+-", "worst", "precise", "feasible", "narrow"]
    lines = []
    for label, entry in rows:
        if entry is not None:
            lines.append(
                [
                    label,
                    *entry["point"],
                    entry["E"],
                    entry["standard_error"],
                    entry["worst"],
                    entry["worst_precise"],
                    entry["feasible"],
                    entry.get("narrow", ""),
                ]
            )
    return table(header, lines)


if __name__ == "__main__":
    main()
