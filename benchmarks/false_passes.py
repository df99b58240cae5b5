"""How often a parameter set that breaks a limit gets a PASS, at first and within five attempts.

    python benchmarks/false_passes.py                     100 of each case
    python benchmarks/false_passes.py --samples 40 rare mean   some cases, fewer of each

Every parameter set here breaks its limit, by a kind of machine that people have: in one load or one
terrain only, with two kinds of runs, or with noise that grows with the context. The certificate is
that of `bo_tuner.certify`, without what it tells beside the verdict. Attempts share the confidence
of 95 %, so that at the first one 4 % may pass at most, and within five 5 %.
"""

import math
import statistics
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from common import provenance, read_result, result_parser, table, write_result
from repeated_certificates import after
from threadpoolctl import threadpool_limits

import bo_tuner as bt
from bo_tuner.backends.function import FunctionBackend
from bo_tuner.evidence.certificate.certification import Certification
from bo_tuner.evidence.certificate.findings import NOTHING
from bo_tuner.evidence.certificate.judgement import judge
from bo_tuner.evidence.certificate.plan import Subject
from bo_tuner.numerics.sequential import spent
from bo_tuner.tuning.driver import Driver

ATTEMPTS, CONFIDENCE, MOST = 5, 0.95, 1000

Noise = np.random.Generator
Peak = Callable[[Mapping[str, Any], Noise], float]
"""The limited metric in a context; its limit is 1."""


@dataclass(frozen=True)
class Case:
    """A machine that breaks its limit.

    Attributes
    ----------
    title
        What it does.
    peak
        The limited metric.
    contexts
        By name.
    probability
        With which a run must keep the limit; None for a limit on the mean.
    range
        Declared of the metric, if any.
    """

    title: str
    peak: Peak
    contexts: Mapping[str, Any] = field(default_factory=dict)
    probability: float | None = None
    range: tuple[float, float] | None = None

    def study(self, seed: int) -> Any:
        """Return the study with its limit."""
        limit = bt.WorstCase("peak", upper=1.0, probability=self.probability)
        peak = {} if self.range is None else {"range": self.range}
        return bt.Study(
            name="false_passes",
            parameters={"gain": bt.Double(0.0, 1.0, default=0.5)},
            contexts=dict(self.contexts),
            metrics={"error": {}, "peak": peak},
            objective="error",
            constraints={"peak": limit},
            budget=bt.Budget(trials=5, initial_trials=3),
            seed=seed,
        ).checked


def within(noise: Noise) -> float:
    """Return a run that is far within the limit."""
    return 0.5 + 0.05 * noise.standard_normal()


def two_kinds(share: float, size: float, other: float, noise: Noise) -> float:
    """Return a run of size `size` with a probability of `share`, else of size `other`."""
    return (size if noise.random() < share else other) * (1.0 + 0.02 * noise.standard_normal())


def in_value(
    value: str, share: float, size: float, context: Mapping[str, Any], rng: Noise
) -> float:
    """Return a run that in one value of the terrain alone is large with a probability."""
    if context["terrain"] != value:
        return within(rng)
    return two_kinds(share, size, 0.5, rng)


def at_the_limit(share: float, size: float, _: Mapping[str, Any], rng: Noise) -> float:
    """Return a run of two kinds, with a mean at the limit."""
    return two_kinds(share, size, (1.0 - share * size) / (1.0 - share), rng)


def in_corner(context: Mapping[str, Any], rng: Noise) -> float:
    """Return a run that near one corner alone is large with a probability of 0.12."""
    near = context["load"] > 0.9 and context["wear"] > 0.9
    return two_kinds(0.12, 1.5, 0.5, rng) if near else within(rng)


def four_corners(context: Mapping[str, Any], rng: Noise) -> float:
    """Return a run; its mean is 0.1 % beyond the limit in a corner, and 7 % within in three."""
    return 0.93 + 0.071 * context["load"] * context["wear"] + 0.05 * rng.standard_normal()


def growing(context: Mapping[str, Any], rng: Noise) -> float:
    """Return a run of which 7.6 % are beyond the limit where the noise is the largest."""
    return 0.5 + (0.05 + 0.3 * context["load"]) * rng.standard_normal()


def in_pair(context: Mapping[str, Any], rng: Noise) -> float:
    """Return a run that in one pair of values is beyond the limit with a probability of 0.12."""
    return two_kinds(0.12 * (context["terrain"] == "d" and context["tool"] == "c"), 1.5, 0.5, rng)


RARE = {"terrain": bt.Discrete(values=("usual", "rare"), probabilities=(0.95, 0.05))}
TWELVE = {"terrain": bt.Discrete(values=tuple("abcdefghijkl"))}
PAIRS = {"terrain": bt.Discrete(values=tuple("abcd")), "tool": bt.Discrete(values=tuple("abc"))}
SQUARE = {name: bt.Uniform(bounds=(0.0, 1.0)) for name in ("load", "wear")}
LINE = {"load": bt.Uniform(bounds=(0.0, 1.0))}

CASES: Mapping[str, Case] = {
    "rare": Case(
        "a value in 5 % of draws; there 12 % of runs beyond, 5 % allowed",
        partial(in_value, "rare", 0.12, 1.5),
        RARE,
        0.95,
    ),
    "rare_99": Case(
        "the same; 5 % of runs beyond, 1 % allowed",
        partial(in_value, "rare", 0.05, 1.5),
        RARE,
        0.99,
    ),
    "mean": Case(
        "mean; there 15 % of runs at 4 times the limit",
        partial(in_value, "rare", 0.15, 4.0),
        RARE,
    ),
    "mean_range": Case(
        "the same with a range of 0 to 5",
        partial(in_value, "rare", 0.15, 4.0),
        RARE,
        range=(0.0, 5.0),
    ),
    "corners": Case("mean; a corner 0.1 % over, three 7 % within", four_corners, SQUARE),
    "corner": Case("12 % of runs beyond in a corner alone, 5 % allowed", in_corner, SQUARE, 0.95),
    "growing": Case("noise that grows with the context, 5 % allowed", growing, LINE, 0.95),
    "twelve": Case(
        "one value of twelve; there 12 % of runs beyond, 5 % allowed",
        partial(in_value, "h", 0.12, 1.5),
        TWELVE,
        0.95,
    ),
    "pair": Case("one pair of twelve; there 12 % beyond, 5 % allowed", in_pair, PAIRS, 0.95),
    **{
        f"two_{share:g}_{size:g}": Case(
            f"mean at the limit, {share:g} % of runs at {size:g} times",
            partial(at_the_limit, share / 100.0, size),
        )
        for share, size in ((5.0, 5.0), (5.0, 2.0), (10.0, 2.0), (20.0, 2.0))
    },
    **{
        f"two_{share:g}_{size:g}_range": Case(
            f"the same, {share:g} % at {size:g} times, with a range of 0 to 6",
            partial(at_the_limit, share / 100.0, size),
            range=(0.0, 6.0),
        )
        for share, size in ((5.0, 5.0), (20.0, 2.0))
    },
}


def certify(case: Case, seed: int) -> dict[str, Any]:
    """Certify until it passes; return the attempt, and the runs of the first and of the PASS."""
    study = case.study(seed)

    def function(_: Any, context: dict[str, Any], noise_seed: int) -> dict[str, float]:
        return {"error": 1.0, "peak": case.peak(context, np.random.default_rng(noise_seed))}

    earlier, runs = NOTHING, 0
    for attempt in range(1, ATTEMPTS + 1):
        level = spent(CONFIDENCE, attempt)
        (evidence,) = Certification(
            study, Driver(FunctionBackend(study, function)), confidence=level, attempt=attempt
        ).collect([Subject("tuned", {"gain": 0.5}, earlier=earlier)], MOST)
        findings = judge(study, evidence, level)
        runs = runs or findings.evaluations
        if findings.passed:
            return {"passed": attempt, "first": runs, "of_pass": findings.evaluations}
        earlier = after(earlier, evidence, findings, attempt)
    return {"passed": None, "first": runs, "of_pass": None}


def row(name: str, runs: list[dict[str, Any]]) -> list[object]:
    """Sum up a case."""
    passed = [run["passed"] for run in runs]
    of_pass = [run["of_pass"] for run in runs if run["passed"]]
    return [
        CASES[name].title,
        f"{passed.count(1)} of {len(runs)}",
        f"{len(runs) - passed.count(None)} of {len(runs)}",
        statistics.median(run["first"] for run in runs),
        min(of_pass, default=math.nan),
    ]


def main() -> None:
    """Certify and report."""
    parser = result_parser(__doc__, "false_passes.json")
    parser.add_argument("cases", nargs="*", help=f"of {', '.join(CASES)}; all unless given")
    parser.add_argument("--samples", type=int, default=100)
    arguments = parser.parse_args()
    known = read_result(arguments.result) or {}
    result: dict[str, Any] = {"provenance": provenance(), "cases": known.get("cases", {})}
    with threadpool_limits(1):
        for name in arguments.cases or CASES:
            runs = [certify(CASES[name], seed) for seed in range(1, arguments.samples + 1)]
            print(table(["", "first", "in five", "runs", "fewest"], [row(name, runs)]), flush=True)
            result["cases"][name] = {"title": CASES[name].title, "runs": runs}
            # Each case takes minutes, and those of another call stay.
            write_result(arguments.result, result)


if __name__ == "__main__":
    main()
