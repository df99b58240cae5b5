"""How often a certificate passes what is feasible, and what is just not.

The answers are those of recorded campaigns. Each answer that the tuner called feasible is certified
by the study's default certificate, in process, with fresh draws. Beside it stands a parameter set
that is truly infeasible by as little as possible: on the way from the answer to one drawn at random
that breaks a limit, the first by bisection that the judge of the campaign finds infeasible. The
worst context of the answer is known to its certificate, as that of a run's own search would be; of
the infeasible parameter set nothing is known.
"""

import json
import os
import statistics
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

# Before the libraries that read it.
os.environ.update(OPENBLAS_NUM_THREADS="1")

import numpy as np
from common import BENCHMARKS, opened, provenance, read_result, result_parser, table, write_result

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.evidence.certificate.certification import Certification
from bo_tuner.evidence.certificate.judgement import judge
from bo_tuner.evidence.certificate.plan import Subject
from bo_tuner.evidence.certificate.store import required_draws
from bo_tuner.evidence.words.certificate import reasons
from bo_tuner.numerics.sequential import spent
from bo_tuner.study.study import Study
from bo_tuner.trials import Value
from bo_tuner.tuning.driver import Driver
from tuning_benchmark.experiments.experiment_file import load_experiment
from tuning_benchmark.judging.truth import FEW_REAL_EVALUATIONS, Truth, truth_of
from tuning_benchmark.pages.statistics import share

CASES = (
    ("boundary", "mean"),
    ("boundary", "single-run"),
    ("boundary", "second-axis-mean"),
    ("closed_form", "closed-4-2"),
    ("closed_form", "closed-2-1"),
)
ROW = "boundary"
BISECTIONS = 7
DRAWN = 200
"""Parameter sets that are drawn at random until one breaks a limit."""


def answers(records: Path, experiment: str, case: str) -> list[tuple[int, dict[str, Any]]]:
    """Return seed and answer of each recorded run of the row."""
    lines = (records / f"{experiment}.jsonl").read_text(encoding="utf-8").splitlines()
    found = []
    for record in map(json.loads, lines):
        kind, *where = record["task"].split("/")
        # A run that failed has no result.
        answer = (record["result"] or {}).get("answer")
        if kind == "run" and where[:2] == [case, ROW] and answer:
            found.append((int(where[2]), answer))
    return found


def just_infeasible(
    study: Study, truth: Truth, parameters: Mapping[str, Value], seed: int
) -> dict[str, Value] | None:
    """Return the first infeasible parameter set on the way to one drawn at random."""
    space = study.search_space()
    rng = np.random.default_rng((seed, len(parameters)))
    kept = space.to_cube(parameters)

    def feasible(point: np.ndarray) -> bool:
        values = space.to_parameters(space.repair(point[None])[0])
        return truth.verdict(values, FEW_REAL_EVALUATIONS).feasible

    for broken in rng.random((DRAWN, space.dimension)):
        if not feasible(broken):
            break
    else:
        return None
    for _ in range(BISECTIONS):
        middle = (kept + broken) / 2.0
        if feasible(middle):
            kept = middle
        else:
            broken = middle
    return space.to_parameters(space.repair(broken[None])[0])


def certify(
    study: Study, parameters: Mapping[str, Value], suspected: tuple[Mapping[str, float], ...]
) -> dict[str, Any]:
    """Certify a parameter set by the study's own certificate, and return its verdict and cost."""
    confidence = spent(study.certificate.confidence, 1)
    with opened(InProcessBackend(study)) as backend:
        begin = time.process_time()
        (evidence,) = Certification(study, Driver(backend), confidence=confidence).collect(
            [Subject("tuned", parameters, suspected)],
            required_draws(study, study.certificate.confidence),
        )
    findings = judge(study, evidence, confidence)
    return {
        "passed": findings.passed,
        "evaluations": findings.evaluations,
        "least": findings.least,
        "reasons": reasons(study, findings),
        "seconds": round(time.process_time() - begin, 2),
    }


def summary(certified: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Sum up what `certify` returned of some parameter sets; None of none."""
    if not certified:
        return None
    passed = share(sum(item["passed"] for item in certified), len(certified))
    return {
        "certified": passed.runs,
        "passed": passed.count,
        "interval": [passed.low, passed.high],
        "median_evaluations": statistics.median(i["evaluations"] for i in certified),
        "median_of_least": statistics.median(i["evaluations"] / i["least"] for i in certified),
        "most_evaluations": max(i["evaluations"] for i in certified),
    }


def main() -> None:
    """Certify and report."""
    parser = result_parser(__doc__, "certificates.json")
    parser.add_argument(
        "--records", type=Path, default=BENCHMARKS.parent / "docs" / "records", metavar="DIR"
    )
    names = [case for _, case in CASES]
    parser.add_argument("cases", nargs="*", help=f"of {', '.join(names)}; all unless given")
    arguments = parser.parse_args()
    if unknown := set(arguments.cases) - {*names}:
        parser.error(f"unknown: {', '.join(sorted(unknown))}; there are {', '.join(names)}")
    known = read_result(arguments.result) or {"cases": {}}
    for case in known["cases"].values():
        case.setdefault("commit", known["provenance"]["commit"])
    result: dict[str, Any] = {"provenance": provenance(), "cases": known["cases"]}
    rows = []
    for name, case_name in CASES:
        if arguments.cases and case_name not in arguments.cases:
            continue
        experiment = load_experiment(name)
        case = experiment.cases[case_name]
        truth = truth_of(case.study, experiment.judge)
        runs = []
        for seed, answer in answers(arguments.records, name, case_name):
            study, parameters = case.study.replace(seed=seed), answer["parameters"]
            run: dict[str, Any] = {"seed": seed, "believed": answer["believed"]}
            run["feasible"] = answer["truth"]["feasible"]
            if answer["believed"]:
                run["answer"] = certify(study, parameters, (answer["truth"]["worst_context"],))
            if run["feasible"]:
                beyond = just_infeasible(study, truth, parameters, seed)
                if beyond is not None:
                    verdict = truth.verdict(beyond, FEW_REAL_EVALUATIONS)
                    run["infeasible"] = certify(study, beyond, ()) | {
                        "parameters": beyond,
                        "worst": verdict.worst,
                    }
            runs.append(run)
            print(f"{case_name} {seed}: {run}", flush=True)
        counts: dict[str, Any] = {"title": case.title, "runs": runs}
        counts["commit"] = result["provenance"]["commit"]
        for which in ("answer", "infeasible"):
            found = counts[which] = summary([run[which] for run in runs if which in run])
            if found:
                rows.append(
                    [
                        case_name,
                        which,
                        f"{found['passed']} of {found['certified']}",
                        "{:.0%} to {:.0%}".format(*found["interval"]),
                        found["median_evaluations"],
                        f"{found['median_of_least']:.2g}",
                    ]
                )
        result["cases"][case_name] = counts
        write_result(arguments.result, result)
    print(
        table(
            ["study", "parameter sets", "PASS", "95 %", "median evaluations", "of the least"], rows
        )
    )


if __name__ == "__main__":
    main()
