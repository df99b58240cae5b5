"""How often the bands and bounds of a certificate hold the truth, on random metrics.

    python benchmarks/band_coverage.py

Each case is a random metric of one to three context variables whose worst mean is known
(`synthetic_responses.py`), with a limit that it keeps or violates by up to three standard
deviations of its noise. `validate`'s evaluations are made, and its code judges them. Counted is how
often

- a 90 % band holds the truth, from all evaluations and from the first few alone: draws, and the
  beginning of the search, as a report on a run has them;
- the bound behind a PASS holds the true worst mean, or the true largest probability of a violation;
- the verdict is PASS, of parameter sets that in truth keep the limit and of others.

With `--means-only`, instead of all that, how often the 95 % interval of the mean over the contexts,
by draws as a validation has them, holds the true mean, and how wide it is: with the contexts as
covariates (`context_covariates`), and without.

The result goes to benchmarks/results/band_coverage.json. Seeds up to 2000, and from 100001 on, were
used in development; those of the result were not.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from common import provenance, result_parser, table, write_result
from scipy.stats import norm
from synthetic_responses import Response, largest, response
from threadpoolctl import threadpool_limits

from bo_tuner.backends.protocol import SequentialBackend
from bo_tuner.evidence.certificate.certification import Certification
from bo_tuner.evidence.certificate.context_tolerance import (
    ContextTolerance,
    Drift,
    context_tolerances,
)
from bo_tuner.evidence.certificate.judgement import judge
from bo_tuner.evidence.certificate.plan import Subject
from bo_tuner.evidence.context_covariates import covariates
from bo_tuner.numerics.adjusted_means import adjusted_mean
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import study_from_mapping
from bo_tuner.trials import Evaluation, EvaluationState, Outcome
from bo_tuner.tuning.driver import Driver
from tuning_benchmark.pages.statistics import share

DRAWS = 300
CONFIDENCE = 0.95
PROBABILITY = 0.85
"""Of a single run within its limit."""

MARGINS = (-1.0, -0.3, 0.3, 1.0, 3.0)
"""From the worst case to the limit, in standard deviations of the noise there."""

ALL, FEW = "all evaluations", "few evaluations"
WORST = "worst mean"
"""The band of which each single one is in the result."""

FEW_DRAWS, FEW_SEARCHED = 25, 10
"""Draws and evaluations of the search that are the few."""

SPREAD = 0.2
"""Standard deviation of the contexts that are not uniform, in edges of the cube."""


class MetricBackend(SequentialBackend):
    """Evaluates a response; the noise follows from the seed of an evaluation."""

    name = "synthetic"

    def __init__(self, study: Study, metric: Response) -> None:
        super().__init__(study)
        self._metric = metric

    def open(self) -> None:
        """Need nothing."""

    def close(self) -> None:
        """Hold nothing."""

    def outcome(self, planned: Evaluation) -> Outcome:
        """Return the metric in the context, with noise."""
        u = np.array([list(planned.context.values())])
        noise = np.random.default_rng(planned.seed).standard_normal()
        peak = float(self._metric.mean(u)[0] + self._metric.deviation(u)[0] * noise)
        return Outcome(EvaluationState.COMPLETE, {"error": 1.0, "peak": peak})


def study_of(metric: Response, limit: Mapping[str, Any], seed: int, *, uniform: bool) -> Study:
    """Return a study with a limit on the metric in every context."""
    node = {"node": "machine"}
    context: dict[str, Any] = node | {"distribution": "uniform", "bounds": [0.0, 1.0]}
    if not uniform:
        context |= {"distribution": "truncated_normal", "mean": 0.5, "standard_deviation": SPREAD}
    study = study_from_mapping(
        {
            "name": "synthetic",
            "nodes": {"machine": {"result": "~/result", "object": "synthetic:Machine"} | node},
            "parameters": {"gain": node | {"type": "double", "bounds": [0.0, 1.0], "default": 0.5}},
            "contexts": {f"w{k + 1}": context for k in range(metric.dimension)},
            "seed_parameter": node | {"parameter": "seed"},
            "trigger": node | {"service": "~/run"},
            "metrics": {"error": node, "peak": node},
            "objective": {"metric": "error"},
            "constraints": {"peak": {"kind": "worst_case", "metric": "peak"} | limit},
            "budget": {"trials": 5, "initial_trials": 3},
        }
    )
    return replace(study, seed=seed)


def case(seed: int) -> dict[str, Any]:
    """Certify one random metric, and compare with its truth."""
    rng = np.random.default_rng((20_261_122, seed))
    metric = response(rng)
    single, uniform = bool(rng.integers(2)), bool(rng.integers(2))
    margin = MARGINS[rng.integers(len(MARGINS))]
    z = norm.ppf(PROBABILITY) if single else 0.0
    quantile, where = largest(lambda u: metric.mean(u) + z * metric.deviation(u), metric.dimension)
    limit = quantile + margin * float(metric.deviation(where[None])[0])
    violation, _ = largest(
        lambda u: norm.cdf((metric.mean(u) - limit) / metric.deviation(u)), metric.dimension
    )
    asked = {"upper": limit} | ({"probability": PROBABILITY} if single else {})
    study = study_of(metric, asked, seed, uniform=uniform)
    (evidence,) = Certification(
        study, Driver(MetricBackend(study, metric)), confidence=CONFIDENCE
    ).collect([Subject("tuned", {"gain": 0.5})], DRAWS)
    found = judge(study, evidence, CONFIDENCE)
    (constraint,) = found.constraints
    # As in `make_certificate`: the draws come last.
    ordered = [*evidence.evaluations[len(evidence.drawn) :], *evidence.drawn]
    (tolerance,) = context_tolerances(study, ordered)
    bands = _bands(ALL, tolerance, metric, limit)
    if evidence.search:
        few = [*evidence.drawn[:FEW_DRAWS], *evidence.search[:FEW_SEARCHED]]
        (tolerance,) = context_tolerances(study, few)
        bands += _bands(FEW, tolerance, metric, limit)
    result: dict[str, Any] = {
        "seed": seed,
        "kind": metric.kind,
        "contexts": metric.dimension,
        "heteroscedastic": metric.heteroscedastic,
        "single_run": single,
        "margin": margin,
        "passed": found.passed,
        "evaluations": {
            "draws": len(evidence.drawn),
            "search": len(evidence.search),
            "repeated": sum(map(len, evidence.repeated)),
        },
        "noise": float(metric.deviation(metric.where[None])[0]),
        "truth": metric.worst,
        "bands": bands,
    }
    if found.passed and single:
        result["violation"] = {
            "bound": max(w.violation_bound for w in constraint.worst),
            "truth": violation,
        }
    elif found.passed:
        bound = max(w.mean.upper for w in constraint.worst)
        result["mean"] = {"bound": bound, "truth": metric.worst}
    return result


def _bands(
    source: str, found: ContextTolerance, metric: Response, limit: float
) -> list[dict[str, Any]]:
    """List the bands of a certificate, each with its truth."""
    nominal = np.full(metric.dimension, 0.5)
    names = list(found.worst_context)
    at_worst = np.array(list(found.worst_context.values()))

    def mean(u: np.ndarray) -> float:
        return float(metric.mean(u[None])[0])

    bands = [
        (WORST, found.worst, metric.worst),
        ("nominal mean", found.nominal, mean(nominal)),
    ]
    for variable in found.variables:
        column = names.index(variable.name)
        relieved = at_worst.copy()
        relieved[column] = 0.5
        bands.append(("relief", variable.relief, mean(at_worst) - mean(relieved)))
        for base, drifts in (
            (nominal, (variable.down, variable.up)),
            (at_worst, (variable.worst_down, variable.worst_up)),
        ):
            for drift in drifts:
                crossing = _crossing(metric, base, column, drift, limit)
                if crossing is not None:
                    bands.append(("drift", drift.limit, crossing))
    return [
        {"of": name, "from": source, "low": band.low, "high": band.high, "truth": truth}
        for name, band, truth in bands
    ]


def _crossing(
    metric: Response, base: np.ndarray, column: int, drift: Drift, limit: float
) -> float | None:
    """Return where the mean first exceeds the limit on the way to a bound; None if nowhere."""
    steps = np.linspace(0.5, drift.bound, 2001)
    line = np.tile(base, (len(steps), 1))
    line[:, column] = steps
    above = metric.mean(line) > limit
    return float(steps[int(np.argmax(above))]) if above.any() else None


MEAN_DRAWS = 10, 25, 50, 100
MEANS_EACH = 10
"""Validations of each metric and number of draws."""

TRUE_DRAWS = 100_000


def interval_rows(seeds: Sequence[int]) -> list[list[object]]:
    """Return how often the interval of a mean holds the truth, by the number of draws.

    With and without covariates, and how wide it is with them: median of the ratios.
    """
    held: dict[int, list[tuple[bool, bool, float]]] = {count: [] for count in MEAN_DRAWS}
    for seed in seeds:
        rng = np.random.default_rng((20_261_127, seed))
        metric, uniform = response(rng), bool(rng.integers(2))
        space = study_of(metric, {"upper": 1.0}, seed, uniform=uniform).context_space()
        truth = float(metric.mean(space.draw(TRUE_DRAWS, rng)).mean())
        for count in MEAN_DRAWS:
            for _ in range(MEANS_EACH):
                rows = space.draw(count, rng)
                values = metric.mean(rows) + metric.deviation(rows) * rng.standard_normal(count)
                of_draws = covariates(space, [space.to_dict(row) for row in rows])
                adjusted = adjusted_mean(values, of_draws, CONFIDENCE)
                plain = adjusted_mean(values, of_draws[:, :0], CONFIDENCE)
                held[count].append(
                    (
                        adjusted.low <= truth <= adjusted.high,
                        plain.low <= truth <= plain.high,
                        (adjusted.high - adjusted.low) / (plain.high - plain.low),
                    )
                )
    return [
        [
            count,
            len(found),
            f"{np.mean([with_them for with_them, _, _ in found]):.1%}",
            f"{np.mean([without for _, without, _ in found]):.1%}",
            f"{np.median([ratio for _, _, ratio in found]):.2f}",
        ]
        for count, found in held.items()
    ]


def counted(held: int, count: int) -> dict[str, float | int]:
    """Return a share with its interval, as JSON takes it."""
    found = share(held, count)
    return {"held": found.count, "of": found.runs, "low": found.low, "high": found.high}


def summarize(cases: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Count how often each band and bound holds the truth."""
    bands: dict[str, dict[str, Any]] = {}
    for source in (ALL, FEW):
        for name in (WORST, "nominal mean", "relief", "drift"):
            chosen = [
                (c, b) for c in cases for b in c["bands"] if b["of"] == name and b["from"] == source
            ]
            if not chosen:
                continue
            held = sum(b["low"] <= b["truth"] <= b["high"] for _, b in chosen)
            widths = [b["high"] - b["low"] for _, b in chosen]
            bands[f"{name}, {source}"] = counted(held, len(chosen)) | {
                "below": sum(b["truth"] < b["low"] for _, b in chosen),
                "above": sum(b["truth"] > b["high"] for _, b in chosen),
                "median_width": float(np.median(widths)),
                "median_width_in_noise": float(
                    np.median([(b["high"] - b["low"]) / c["noise"] for c, b in chosen])
                ),
            }
    bounds = {}
    for name in ("mean", "violation"):
        chosen = [c[name] for c in cases if name in c]
        if chosen:
            bounds[name] = counted(sum(b["truth"] <= b["bound"] for b in chosen), len(chosen))
    verdicts = {}
    for name, keeps in (("keeps", True), ("violates", False)):
        passed = [c["passed"] for c in cases if (c["margin"] > 0.0) is keeps]
        if passed:
            verdicts[name] = counted(sum(passed), len(passed))
    return {"bands": bands, "bounds": bounds, "passed": verdicts}


def main() -> None:
    """Count and report."""
    parser = result_parser(__doc__, "band_coverage.json")
    parser.add_argument("--cases", type=int, default=200, help="(default: %(default)s)")
    parser.add_argument("--first", type=int, default=2001, help="first seed (default: %(default)s)")
    parser.add_argument("--means-only", action="store_true", help="intervals of means alone")
    arguments = parser.parse_args()
    seeds = list(range(arguments.first, arguments.first + arguments.cases))
    if arguments.means_only:
        header = ["draws", "validations", "held with covariates", "without", "width"]
        with threadpool_limits(1):
            print(table(header, interval_rows(seeds)))
        return
    about = provenance() | {"seeds": seeds}
    with threadpool_limits(1):
        cases = [case(seed) for seed in seeds]
    found = summarize(cases)
    write_result(arguments.result, {"provenance": about, "summary": found, "cases": len(cases)})
    for name, part in found.items():
        header = list(next(iter(part.values())))
        print(table([name, *header], [[key, *row.values()] for key, row in part.items()]), "\n")


if __name__ == "__main__":
    main()
