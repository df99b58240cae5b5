"""What the certificates of the third-party examples take.

    python benchmarks/example_certificates.py
    python benchmarks/example_certificates.py cessna --seeds 1 2    one example, other results

The parameter sets are those that `examples/NAME/comparison.json` has, tuned over ROS. Here their
flights are those of the example's own judge, in process, and the certificate is the one that the
study asks for, without what its run would know of worst contexts.
"""

import importlib
import json
import statistics
import sys
import time
from typing import Any

from common import BENCHMARKS, provenance, read_result, result_parser, table, write_result
from threadpoolctl import threadpool_limits

from bo_tuner.backends.function import failed
from bo_tuner.backends.protocol import SequentialBackend
from bo_tuner.evidence.certificate.certification import Certification
from bo_tuner.evidence.certificate.judgement import judge
from bo_tuner.evidence.certificate.plan import Subject
from bo_tuner.evidence.certificate.store import required_draws
from bo_tuner.evidence.words.certificate import reasons
from bo_tuner.numerics.sequential import spent
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import load_study
from bo_tuner.trials import Evaluation, EvaluationState, Outcome
from bo_tuner.tuning.driver import Driver

EXAMPLES = ("quadrotor", "cessna")
SEEDS = (1, 2, 3)


class Flights(SequentialBackend):
    """Flies by the judge of an example."""

    name = "judge"

    def __init__(self, study: Study, judge: Any) -> None:
        super().__init__(study)
        self._study = study
        self._judge = judge

    def open(self) -> None:
        """Need nothing."""

    def close(self) -> None:
        """Hold nothing."""

    def outcome(self, planned: Evaluation) -> Outcome:
        """Fly once."""
        conditions = self._judge.Conditions(**planned.context, seed=planned.seed)
        found = self._judge.judge(planned.parameters, conditions)
        if found.crashed:
            return failed("crash")
        metrics = {name: getattr(found, name) for name in self._study.metrics}
        return Outcome(EvaluationState.COMPLETE, metrics)


def judge_of(example: str) -> Any:
    """Import the judge of an example; the modules of all are named alike."""
    for name in ("judge", "aircraft", "flight"):
        sys.modules.pop(name, None)
    sys.path.insert(0, str(BENCHMARKS.parent / "examples" / example))
    try:
        return importlib.import_module("judge")
    finally:
        del sys.path[0]


def certify(example: str, seed: int) -> dict[str, Any]:
    """Certify the parameter set tuned with a seed; return the verdict, and what it took."""
    folder = BENCHMARKS.parent / "examples" / example
    study = load_study(folder / "study.yaml").replace(seed=seed)
    known = json.loads((folder / "comparison.json").read_text(encoding="utf-8"))
    gains = known["judged"][f"tuned, seed {seed}"]["gains"]
    parameters = study.complete_set(gains)
    confidence = spent(study.certificate.confidence, 1)
    driver, begin = Driver(Flights(study, judge_of(example))), time.process_time()
    (evidence,) = Certification(study, driver, confidence=confidence).collect(
        [Subject("tuned", parameters)], required_draws(study, study.certificate.confidence)
    )
    findings = judge(study, evidence, confidence)
    return {
        "seed": seed,
        "passed": findings.passed,
        "evaluations": findings.evaluations,
        "drawn": len(evidence.drawn),
        "least": findings.least,
        "reasons": reasons(study, findings),
        "seconds": round(time.process_time() - begin, 1),
    }


def main() -> None:
    """Certify and report."""
    parser = result_parser(__doc__, "example_certificates.json")
    parser.add_argument("examples", nargs="*", help=f"of {', '.join(EXAMPLES)}; all unless given")
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS, metavar="N")
    arguments = parser.parse_args()
    known = read_result(arguments.result) or {}
    result: dict[str, Any] = {"provenance": provenance(), "examples": known.get("examples", {})}
    with threadpool_limits(1):
        for example in arguments.examples or EXAMPLES:
            runs = []
            for seed in arguments.seeds:
                runs.append(certify(example, seed))
                print(example, runs[-1], flush=True)
            result["examples"][example] = runs
            write_result(arguments.result, result)
    rows = [
        [
            example,
            f"{sum(run['passed'] for run in runs)} of {len(runs)}",
            statistics.median(run["evaluations"] for run in runs),
            runs[0]["least"],
        ]
        for example, runs in result["examples"].items()
    ]
    print(table(["example", "PASS", "flights, median", "least"], rows))


if __name__ == "__main__":
    main()
