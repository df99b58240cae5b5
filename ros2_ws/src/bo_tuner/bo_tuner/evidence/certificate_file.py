"""The file of a certificate, with what is said of it for readers."""

import json
from collections.abc import Mapping
from pathlib import Path

from bo_tuner.codec.writing import to_json
from bo_tuner.evidence.certificate.certificate import Certificate
from bo_tuner.evidence.certificate.claim import objections
from bo_tuner.evidence.certificate.context_tolerance import CREDIBLE
from bo_tuner.evidence.certificate.evaluations_file import evaluations_csv
from bo_tuner.evidence.certificate.findings import TAIL, Evidence
from bo_tuner.evidence.certificate.store import FORMAT, evaluations_path, next_path
from bo_tuner.evidence.words.certificate import assumptions, warnings
from bo_tuner.evidence.words.facts import in_words
from bo_tuner.storage.atomic import write_atomically
from bo_tuner.study.study import Study


def certificate_text(study: Study, certificate: Certificate) -> str:
    """Return the text of a certificate's file.

    Besides the certificate it has what follows from it, for people and for other programs.
    """
    content = {
        "format": FORMAT,
        "verdict": certificate.verdict,
        "reasons": [*map(in_words, objections(study, certificate.tuned))],
        "assumptions": assumptions(study, certificate.tuned),
        "warnings": [*warnings(study, certificate)],
        "parameters": dict(certificate.parameters),
        "tail_level": TAIL,
        "credible": CREDIBLE,
        **to_json(certificate),
    }
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def write_certificate(
    folder: Path, study: Study, certificate: Certificate, evidence: Mapping[str, Evidence]
) -> Path:
    """Write the evaluations, then the certificate with their digest; return the latter's path.

    Earlier certificates stay. The file of the certificate comes last: without it, after a crash,
    its evaluations are no certificate.
    """
    path = next_path(folder, certificate.attempt)
    table = evaluations_csv(evidence, certificate.contexts, certificate.metrics)
    write_atomically(evaluations_path(path), table)
    return write_atomically(path, certificate_text(study, certificate))
