"""Certificates of which every number is made up, and their content as JSON."""

import json
from dataclasses import replace

from bo_tuner.evidence.certificate.certificate import Certificate, CertifiedObjective
from bo_tuner.evidence.certificate.findings import (
    ConstraintVerdict,
    EarlierInBrief,
    Failure,
    Findings,
    WorstContext,
)
from bo_tuner.evidence.certificate.risk import Mean
from bo_tuner.evidence.certificate.search_width import SearchWidth
from bo_tuner.evidence.certificate.store import parameters_sha256
from bo_tuner.evidence.certificate.winners_curse import Gap
from bo_tuner.evidence.certificate_file import certificate_text
from bo_tuner.evidence.estimates import Estimate, Source
from bo_tuner.evidence.facts import Drift
from bo_tuner.evidence.reasons import Reason, Why
from bo_tuner.storage.provenance import provenance, study_sha256

WORST = WorstContext(
    context={"load": 2.0},
    mean=Mean(0.75, 0.01, upper=0.77, lower=0.73),
    extreme=1.05,
    evaluations=30,
    beyond=1,
    failures=0,
    violation_bound=0.11,
    shown=True,
)


def made_findings(study, parameters, violations, passed):
    """Findings in 112 draws; each worst-case limit of a study with the context load has one."""
    searched = list(study.contexts) == ["load"]
    constraints = tuple(
        ConstraintVerdict(
            name=name,
            kind=item.kind,
            metric=item.metric,
            unit=study.metrics[item.metric].unit,
            limit=item.limit,
            side=item.side,
            allowed=item.allowed,
            draws=112,
            violations=violations,
            failures=0,
            violation_bound=0.0123,
            extreme=0.9,
            tail=0.8,
            worst=(replace(WORST, shown=passed),) * (searched and item.rule.in_every_context),
            assumption=None,
            refuted=not passed,
            passed=passed,
            reason=Reason(Why.SHARE),
        )
        for name, item in study.constraints.items()
    )
    # A study without limits has nothing else to fail on.
    failures = 0 if passed or constraints else 1
    mean = Estimate(1.5, 0.02, 112, Source.CERTIFICATE, False, 1.46, 1.54)
    first = Failure("it <b>stopped</b>", {}, 7) if failures else None
    return Findings(parameters, mean, 1.9, 320, failures, first, None, 141, constraints)


def made_certificate(study, parameters, passed=True, *, backend="inprocess", algorithm="boundary"):
    """A certificate of a study for a parameter set, with a default that failed."""
    return Certificate(
        study=study.name,
        study_sha256=study_sha256(study),
        trial=3,
        parameters_sha256=parameters_sha256(parameters),
        held={},
        seen={},
        best_yaml_sha256=None,
        evaluations_sha256="0" * 64,
        draws=study.certificate.draws,
        drawn=112,
        confidence=study.certificate.confidence,
        attempt=1,
        bound_confidence=0.975,
        contexts={name: item.unit for name, item in study.contexts.items()},
        metrics={name: item.unit for name, item in study.metrics.items()},
        objective=CertifiedObjective("error", "s", "minimize"),
        tuned=made_findings(study, dict(parameters), 0, passed),
        default=made_findings(study, study.search_space().defaults, 8, False),
        earlier=EarlierInBrief((), 0, ()),
        search_widths=(SearchWidth(0.9, 0.14),),
        training_gaps=(Gap("mean error", "s", 1.2, 0.0, 1.3, 1.5, 0.1),),
        context_tolerances=(),
        parameter_sensitivity=None,
        deaths=None,
        in_force=("in force: kp, set on pid while it runs, and read back",),
        high_load=None,
        drifts=(Drift("peak", "tuned", 112, False, 0.61, 0.002),),
        two_kinds=(),
        uneven=(),
        provenance=provenance(study, backend, algorithm),
        finished="2026-01-01T00:00:00+00:00",
    )


def content_of(study, certificate):
    """The content of its file, to be changed."""
    return json.loads(certificate_text(study, certificate))
