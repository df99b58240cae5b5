"""Run folders made by the tuner's own parts in this process, without the command."""

import hashlib
import json
from dataclasses import replace

from made_certificates import content_of, made_certificate

from bo_tuner.evidence.certificate.store import evaluations_path, next_path
from bo_tuner.methods.registry import METHODS
from bo_tuner.storage.journal import Journal
from bo_tuner.storage.provenance import (
    session_provenance,
    study_sha256,
)
from bo_tuner.storage.record import read_run
from bo_tuner.storage.session_options import SessionOptions
from bo_tuner.study.study_file import study_to_yaml
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.journaling import JournalObserver
from bo_tuner.tuning.loop import Tuning

INITIAL = {"trials": 3, "initial_trials": 3, "drawn_contexts": 2, "search_evaluations": 1}
"""Budget of a run that needs no surrogates."""


def make_run(folder, study, backend, *, result=None, backend_name="inprocess", attached=False):
    """Run a study's trials and leave their record; returns it.

    With `result`, the number of a trial, the run has ended with that one.
    """
    folder.mkdir()
    if attached:
        (folder / "log").mkdir()
    (folder / "study.yaml").write_text(study_to_yaml(study))
    backend.open()
    try:
        who = session_provenance(study, backend_name, "IV")
        if attached:
            who |= SessionOptions(attached=True).provenance
        with Journal(folder / "journal.sqlite", who) as journal:
            for trial in Tuning(study, Driver(backend, JournalObserver(journal)), METHODS["IV"]):
                journal.record_trial(trial)
    finally:
        backend.close()
    if result is not None:
        summary = summary_of(read_run(folder), result)
        (folder / "summary.json").write_text(json.dumps(summary))
    return read_run(folder)


def summary_of(record, result):
    """A summary that names a trial as the result, of no draws, so that nothing refutes it."""
    study = record.study
    sample = {"worst": None, "count": 0, "violations": 0, "permitted": 0, "standing": "open"}
    of_both = {
        "draws": 0, "failures": 0, "lost": 0, "objective": None, "deviation": None,
        "constraints": {name: sample | {"name": name} for name in study.constraints},
    }  # fmt: skip
    return {
        "study_sha256": study_sha256(study),
        "trials": len(record.trials),
        "evaluations": len(record.evaluations),
        "passed_check": True,
        "trial": result,
        "stopped_early": False,
        "default": of_both | {"parameters": study.search_space().defaults},
        "tuned": of_both | {"parameters": dict(record.trials[result].parameters)},
    }


def write_certificate(record, trial, verdict="PASS", study=None, number=None, **changes):
    """Certify a trial, with some of the content, the study or the parameters changed."""
    study = study or record.study
    parameters = dict(trial.parameters) | changes.pop("parameters", {})
    path = next_path(record.path)
    if number is not None:
        path = path.with_name(f"{number:04d}.json")
    evaluations_path(path).write_text("evaluations")
    made = made_certificate(
        study, parameters, verdict != "FAIL", backend=record.backend, algorithm=record.algorithm
    )
    digest = hashlib.sha256(b"evaluations").hexdigest()
    content = content_of(study, replace(made, default=None, evaluations_sha256=digest))
    path.write_text(json.dumps(content | {"verdict": verdict} | changes))
    return path
