"""How often a certificate passes a violation in a narrow bump, at first and within three attempts.

    python benchmarks/repeated_certificates.py

Each of the 36 parameter sets breaks its limit on the mean by 20 % in a Gaussian bump somewhere
inside the context box, and keeps it by far elsewhere. Each is certified again until it passes, at
most three times: once as if nothing was known of the attempts before, and once with them. Told is
also how often the search met the violation, beside what the certificate says of such widths.

The second table is on noise: how often runs with a mean exactly at the limit show that it is kept,
in the first of five certificates and in any of them, with the metric's range declared and without.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from band_coverage import MetricBackend, study_of
from common import provenance, result_parser, table, write_result
from synthetic_responses import Response
from threadpoolctl import threadpool_limits

from bo_tuner.evidence.certificate.certification import Certification
from bo_tuner.evidence.certificate.earlier import refuted_by
from bo_tuner.evidence.certificate.findings import NOTHING, Earlier, Evidence, Findings
from bo_tuner.evidence.certificate.judgement import judge
from bo_tuner.evidence.certificate.plan import Subject
from bo_tuner.evidence.certificate.search_width import distances
from bo_tuner.numerics.mean_tests import Betting, MeanTest, NormalOrSkewed
from bo_tuner.numerics.sequential import spent
from bo_tuner.tuning.driver import Driver

WIDTHS = {1: (0.01, 0.03), 2: (0.03, 0.06), 3: (0.06, 0.12)}
"""Standard deviations of the bump in edges of the box, by the number of context variables."""

PLACES = 6
"""Bumps of each width."""

BASE, EXCESS, NOISE = 0.5, 0.2, 0.05
"""Mean far from the bump, excess at its top, and noise of a run, in limits."""

DRAWS, CONFIDENCE, ATTEMPTS = 300, 0.95, 3
PARAMETERS = {"gain": 0.5}

LAWS: Mapping[str, Callable[[np.random.Generator, int], np.ndarray]] = {
    "normal": lambda rng, n: 1.0 + 0.3 * rng.standard_normal(n),
    "log-normal, sigma 0.5": lambda rng, n: _log_normal(rng, n, 0.5),
    "log-normal, sigma 0.8": lambda rng, n: _log_normal(rng, n, 0.8),
    "log-normal, sigma 1.2": lambda rng, n: _log_normal(rng, n, 1.2),
    "5 % at five times the mean": lambda rng, n: _rare(rng, n, 0.05, 5.0),
    "1 % at thirty times the mean": lambda rng, n: _rare(rng, n, 0.01, 30.0),
}
"""Noise with a mean of 1, the limit."""

RANGE = 60.0
"""Upper end of the declared range; log-normal values beyond it, one in 10,000 at most, are cut."""

SAMPLES, LAW_ATTEMPTS, MOST_RUNS, LOOK = 300, 5, 400, 20
"""A certificate looks after each run, here after so many: later runs may show two kinds."""


def _log_normal(rng: np.random.Generator, count: int, sigma: float) -> np.ndarray:
    return np.exp(sigma * rng.standard_normal(count) - 0.5 * sigma**2)


def _rare(rng: np.random.Generator, count: int, share: float, size: float) -> np.ndarray:
    """Return a share of the values at a size, and the others such that the mean is 1."""
    rest = (1.0 - share * size) / (1.0 - share)
    return np.where(rng.random(count) < share, size, rest) * (
        1.0 + 0.02 * rng.standard_normal(count)
    )


def law_row(name: str) -> dict[str, Any]:
    """Return in how many of the samples of a law a certificate, and any of five, is wrong."""
    rng = np.random.default_rng(20_261_127)
    found: dict[str, Any] = {"law": name, "samples": SAMPLES}
    tests: dict[str, MeanTest] = {
        "without": NormalOrSkewed(),
        "with": Betting(-RANGE, RANGE),
    }
    first, ever = dict.fromkeys(tests, 0), dict.fromkeys(tests, 0)
    for _ in range(SAMPLES):
        runs = [np.minimum(LAWS[name](rng, MOST_RUNS), RANGE) for _ in range(LAW_ATTEMPTS)]
        for key, test in tests.items():
            wrong = [
                any(
                    test.of(values[:n])(1.0, math.log(1.0 / (1.0 - spent(CONFIDENCE, k + 1))))
                    for n in range(LOOK, MOST_RUNS + 1, LOOK)
                )
                for k, values in enumerate(runs)
            ]
            first[key] += wrong[0]
            ever[key] += any(wrong)
    return found | {"first": first, "ever": ever}


@dataclass(frozen=True)
class Bump:
    """A limit that is broken in one place only."""

    dimension: int
    width: float
    seed: int

    @property
    def response(self) -> Response:
        """The metric, with a limit of 1."""
        middle = np.random.default_rng((20_261_127, self.seed)).uniform(0.1, 0.9, self.dimension)

        def mean(u: np.ndarray) -> np.ndarray:
            squares = (((u - middle) / self.width) ** 2).sum(axis=1)
            return BASE + (1.0 + EXCESS - BASE) * np.exp(-0.5 * squares)

        return Response(
            "bump",
            self.dimension,
            False,
            mean,
            lambda u: np.full(len(u), NOISE),
            1.0 + EXCESS,
            middle,
        )

    @property
    def violated(self) -> float:
        """Diameter of the ball in which the mean is beyond the limit, in edges of the box."""
        return 2.0 * self.width * math.sqrt(2.0 * math.log((1.0 + EXCESS - BASE) / (1.0 - BASE)))


def bumps() -> Iterator[Bump]:
    """Yield the parameter sets, as the bumps of their metric."""
    seed = 0
    for dimension, widths in WIDTHS.items():
        for width in widths:
            for _ in range(PLACES):
                seed += 1
                yield Bump(dimension, width, seed)


def after(earlier: Earlier, evidence: Evidence, findings: Findings, k: int) -> Earlier:
    """Return what is known after the k-th attempt, which failed."""
    failed = refuted_by(f"{k:04d}", findings, evidence.evaluations)
    return Earlier(
        (*earlier.refutations, failed),
        (*earlier.evaluations, *evidence.evaluations),
        certified=True,
    )


def certify(bump: Bump, *, remembered: bool) -> dict[str, Any]:
    """Certify until it passes, and return in which attempt it did; None if in none."""
    metric = bump.response
    study = study_of(metric, {"upper": 1.0}, bump.seed, uniform=True)
    earlier = NOTHING
    first: dict[str, Any] = {}
    for attempt in range(1, ATTEMPTS + 1):
        confidence = spent(CONFIDENCE, attempt)
        (evidence,) = Certification(
            study, Driver(MetricBackend(study, metric)), confidence=confidence, attempt=attempt
        ).collect([Subject("tuned", PARAMETERS, earlier=earlier)], DRAWS)
        findings = judge(study, evidence, confidence)
        first = first or _search(study.context_space(), evidence, metric, bump)
        if findings.passed:
            return first | {"passed": attempt}
        if remembered:
            earlier = after(earlier, evidence, findings, attempt)
    return first | {"passed": None}


def _search(space: Any, evidence: Evidence, metric: Response, bump: Bump) -> dict[str, Any]:
    """Return whether the search met the violation, and how probably it meets one so wide."""
    contexts = [e.context for e in evidence.evaluations]
    met = bool((metric.mean(space.cube_of(contexts)) > 1.0).any())
    found = float(np.mean(2.0 * distances(space, contexts) <= bump.violated))
    return {"met": met, "probability": found}


def row(title: str, runs: Sequence[Mapping[str, Any]]) -> list[object]:
    """Sum up what `certify` returned of all parameter sets."""
    passed = [run["passed"] for run in runs]
    return [title, f"{passed.count(1)} of {len(runs)}", len(runs) - passed.count(None)]


def main() -> None:
    """Certify and report."""
    parser = result_parser(__doc__, "repeated_certificates.json")
    parser.add_argument("--noise-only", action="store_true", help="the second table alone")
    arguments = parser.parse_args()
    laws = [law_row(name) for name in LAWS]
    shares = [
        [
            row["law"],
            *(
                f"{100.0 * row[c][k] / SAMPLES:.1f} %"
                for k in ("without", "with")
                for c in ("first", "ever")
            ),
        ]
        for row in laws
    ]
    print(table(["noise", "no range, first", "in five", "range, first", "in five"], shares))
    if arguments.noise_only:
        return
    result: dict[str, Any] = {"provenance": provenance(), "runs": {}, "noise": laws}
    rows = []
    with threadpool_limits(1):
        for title, remembered in (("each on its own", False), ("with those before", True)):
            runs = [asdict(b) | certify(b, remembered=remembered) for b in bumps()]
            result["runs"][title] = runs
            rows.append(row(title, runs))
    met = sum(run["met"] for run in runs)
    expected = sum(run["probability"] for run in runs)
    write_result(arguments.result, result)
    print(table(["attempts", "PASS at first", f"within {ATTEMPTS}"], rows))
    print(f"violations met by the first search: {met} of {len(runs)}; by its widths {expected:.1f}")


if __name__ == "__main__":
    main()
