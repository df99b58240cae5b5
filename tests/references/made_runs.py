"""Run folders made by the tuner's own parts in this process, without the command."""

import hashlib
import json

from bo_tuner.optimizers.algorithms import ALGORITHMS
from bo_tuner.storage.journal import Journal
from bo_tuner.storage.provenance import provenance
from bo_tuner.storage.record import read_run
from bo_tuner.study.study_file import study_to_yaml
from bo_tuner.tuning.journaling import JournalObserver
from bo_tuner.tuning.loop import Tuning

INITIAL = {"trials": 3, "initial_trials": 3, "drawn_contexts": 2, "search_evaluations": 1}
"""Budget of a run that needs no surrogates."""


class Uninterrupted:
    """In place of the interruption by signals."""

    def check(self):
        pass

    def ignore(self):
        pass


def make_run(folder, study, backend, *, result=None, backend_name="inprocess"):
    """Run a study's trials and leave their record; returns it.

    With `result`, the number of a trial, the run has ended with that one.
    """
    (folder / "log").mkdir(parents=True)
    (folder / "study.yaml").write_text(study_to_yaml(study))
    backend.open()
    try:
        with Journal(folder / "journal.sqlite", provenance(study, backend_name, "IV")) as journal:
            for trial in Tuning(
                study, backend, ALGORITHMS["IV"], observer=JournalObserver(journal)
            ):
                journal.record_trial(trial)
    finally:
        backend.close()
    if result is not None:
        summary = {"trial": result, "feasible": True}
        (folder / "summary.json").write_text(json.dumps(summary))
    return read_run(folder)


def write_certificate(record, trial, verdict="PASS", study=None, **parameters):
    """Certify a trial, with some of its parameters, or the study, changed."""
    content = {
        "verdict": verdict,
        "parameters": dict(trial.parameters) | parameters,
        "study_sha256": hashlib.sha256(study_to_yaml(study or record.study).encode()).hexdigest(),
    }
    (record.path / "certificate.json").write_text(json.dumps(content))
