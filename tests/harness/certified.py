"""Evaluations for certificates, and the limits that they are held against."""

from bo_tuner.evidence.certificate.certification import Certification
from bo_tuner.evidence.certificate.plan import Subject
from bo_tuner.tuning.driver import Driver

LIMIT = 1.0
CHANCE = {
    "constraints": {
        "peak": {"kind": "chance", "metric": "peak", "upper": LIMIT, "probability": 0.96}
    }
}


def collect(study, backend, draws, **subjects):
    items = [Subject(name, {"gain": gain}) for name, gain in subjects.items()]
    return Certification(study, Driver(backend), confidence=0.95).collect(items, draws)
