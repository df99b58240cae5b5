"""Records with values of other types and sizes, and checksums that fit: a person's work, no disk's.

Whatever a row of the journal, the summary, the certificate or a parameter file is made to say, each
of the readers answers, or refuses in a line.
"""

import json
import math
import random
import shutil
import sqlite3
import warnings
from contextlib import closing

import yaml
from contracts import one_line
from functions import FunctionBackend
from small_run import make_run

from bo_tuner.backends.recorded import RecordedEvaluations
from bo_tuner.cli import validate as validate_command
from bo_tuner.deploy.bundle import DEPLOY, ROLLBACK, read_rollback, result_of, write_bundle
from bo_tuner.errors import BoTunerError
from bo_tuner.evidence.certificate.certification import Certification
from bo_tuner.evidence.certificate.making import make_certificate
from bo_tuner.evidence.certificate.plan import Subject
from bo_tuner.evidence.certificate.store import CERTIFICATES, certificate_problem
from bo_tuner.evidence.certificate_file import write_certificate
from bo_tuner.methods.registry import METHODS
from bo_tuner.replay.replay import BEST as THE_BEST
from bo_tuner.replay.replay import WORST, find_evaluation, find_trial, replay
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.page import chapters
from bo_tuner.report.sections.answer import answer
from bo_tuner.storage.csv_tables import export_csv
from bo_tuner.storage.journal import COLUMNS, checksum
from bo_tuner.storage.journal_repair import salvage
from bo_tuner.storage.record import read_run
from bo_tuner.storage.run_folder import BEST, JOURNAL, SUMMARY, RunFolder
from bo_tuner.trials import DEFAULT, TUNED
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning
from bo_tuner.tuning.summary import conclude, summarize, with_summary

ALGORITHM = METHODS["IV"]
FILES = (SUMMARY, f"{CERTIFICATES}/0001.json", BEST, f"{DEPLOY}/{ROLLBACK}")
VALUES = (
    None, True, False, 0, -1, 1, 3, 2**63, -(2**70), 10**400, 0.5, -0.0, 1e-320, 1e99, 1e101, 1e308,
    -1e308, math.nan, math.inf, -math.inf, "", "x", "1", "0.5", "nan", "complete", "failed", "PASS",
    "=1+1", "\x1b[2J\n\u202e", "\ud800", "x" * 5_000, [], [1], [[1]], {}, {"x": 1}, {"": None},
    [None],
)  # fmt: skip


def backend_of(study):
    """Make a backend that evaluates a function."""

    def function(gain, load, seed):
        return {"error": 25 * (gain - 0.3) ** 2 + load, "peak": 0.2 + 0.001 * (seed % 7)}

    return FunctionBackend(study, function)


def make_whole_run(folder):
    """Make a run folder with everything in it: summary, certificate and bundle."""
    make_run(folder)
    record = read_run(folder)
    study = record.study
    backend = backend_of(study)
    found = conclude(study, Driver(backend), ALGORITHM, record.trials)
    trial = found.recommendation.candidate.trial
    counts = {"trials": len(record.trials), "evaluations": len(record.evaluations)}
    summary = summarize(study, found, None, stop_early=False, finish=None, **counts)
    with closing(RunFolder(folder)) as writer:
        writer.write_parameters(study, trial.parameters)
        writer.write_json(SUMMARY, summary)
    record = read_run(folder)
    subjects = [Subject(DEFAULT, study.search_space().defaults), Subject(TUNED, trial.parameters)]
    found = Certification(study, Driver(backend), confidence=0.9).collect(subjects, 10)
    evidence = {s.name: item for s, item in zip(subjects, found, strict=True)}
    certificate = make_certificate(record, trial, evidence, 10, 0.9, 1, "inprocess", None)
    write_certificate(folder, study, certificate, evidence)
    write_bundle(record)
    return folder


def mutate(folder, rng):
    """Change one to three values of a record; tells which."""
    return [
        _change_row(folder, rng) if rng.random() < 0.5 else _change_file(folder, rng)
        for _ in range(rng.choice((1, 1, 1, 2, 3)))
    ]


def _change_row(folder, rng):
    table = rng.choice(("session", "trial", "evaluation"))
    columns = COLUMNS[table]
    with closing(sqlite3.connect(folder / JOURNAL, isolation_level=None)) as db:
        rows = db.execute(f"SELECT rowid, {', '.join(columns)} FROM {table}").fetchall()
        rowid, *values = rng.choice(rows)
        at = rng.randrange(len(columns))
        old = values[at]
        document = _document(old)
        if document and rng.random() < 0.8:
            values[at] = json.dumps(_changed(document, rng))
        else:
            values[at] = _storable(rng.choice((*VALUES, b"\xff\x00")))
        # What the table makes of a value of another type is what its reader sees.
        marks = ", ".join(f"{name} = ?" for name in columns)
        try:
            db.execute(f"UPDATE {table} SET {marks} WHERE rowid = ?", (*values, rowid))
        except sqlite3.IntegrityError:
            return "refused by the table"
        query = f"SELECT {', '.join(columns)} FROM {table} WHERE rowid = ?"
        stored = db.execute(query, (rowid,)).fetchone()
        sum_ = checksum(stored)
        db.execute(f"UPDATE {table} SET checksum = ? WHERE rowid = ?", (sum_, rowid))
    return f"{table} {rowid} {columns[at]}: {values[at]!r:.60}"


def _document(text):
    """Parse JSON; None for any other value, which an earlier change may have left."""
    try:
        found = json.loads(text)
    except (TypeError, ValueError):
        return None
    return found if isinstance(found, dict | list) else None


def _storable(value):
    if isinstance(value, list | dict):
        return json.dumps(value)
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        return float(value) if abs(value) < 1e300 else str(value)[:30]
    if isinstance(value, str):
        return value.encode("utf-8", "replace").decode()
    return value


def _change_file(folder, rng):
    path = folder / rng.choice(FILES)
    text = path.read_text()
    parse, dump = (json.loads, json.dumps) if path.suffix == ".json" else (yaml.safe_load, _yaml)
    document = parse(text)
    if isinstance(document, dict | list):
        path.write_text(dump(_changed(document, rng)))
    return f"{path.name}"


def _yaml(document):
    return json.dumps(document) if "\ud800" in repr(document) else yaml.safe_dump(document)


def _changed(document, rng):
    """Replace, delete, rename or add a value anywhere in a document."""
    places = list(_places(document))
    parent, key = rng.choice(places) if places else (None, None)
    if parent is None or rng.random() < 0.03:
        return rng.choice(VALUES)
    how = rng.random()
    if how < 0.7:
        parent[key] = rng.choice(VALUES)
    elif how < 0.85 or isinstance(parent, list):
        del parent[key]
    else:
        parent[rng.choice(("x", "", "gain", "\x1b"))] = parent.pop(key)
    return document


def _places(document):
    items = document.items() if isinstance(document, dict) else enumerate(document)
    for key, value in items:
        yield document, key
        if isinstance(value, dict | list):
            yield from _places(value)


def _read(folder):
    return read_run(folder)


def _report(folder):
    analysis = Analysis(with_summary(read_run(folder), one_line))
    answer(analysis)
    chapters(analysis)


def _replay(folder):
    record = read_run(folder)
    for which in (THE_BEST, WORST):
        found = find_evaluation(record, find_trial(record, which), None)
        replay(record, found, backend_of(record.study))


def _validate(folder):
    validate_command._trial(with_summary(read_run(folder), one_line), None)


def _apply(folder):
    record = with_summary(read_run(folder), one_line)
    trial = result_of(record)
    one_line(certificate_problem(record, trial) or "none")
    read_rollback(record)
    write_bundle(record)


def _resume(folder):
    record = read_run(folder)
    content, _ = salvage(folder / JOURNAL)
    study = record.study.replace(trials=len(content.trials) + 1)
    backend = RecordedEvaluations(backend_of(study), study, content.evaluations)
    tuning = Tuning(study, Driver(backend), ALGORITHM, trials=content.trials)
    list(tuning)
    ALGORITHM.ranking.rank(study, tuning.trials)
    export_csv(folder / JOURNAL, folder, study.search_space().active)


READERS = {
    "read": _read,
    "report": _report,
    "replay": _replay,
    "validate": _validate,
    "apply": _apply,
    "resume": _resume,
}


def check_record(whole, scratch, number):
    """Mutate the record of a whole run; all readers answer or refuse it in a line.

    Returns
    -------
    dict
        By reader whether it answered.
    """
    shutil.rmtree(scratch, ignore_errors=True)
    shutil.copytree(whole, scratch)
    rng = random.Random(number)
    what = mutate(scratch, rng)
    answered = {}
    for name, reader in READERS.items():
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)
                reader(scratch)
            answered[name] = True
        except BoTunerError as error:
            one_line(error)
            answered[name] = False
        except Exception as error:
            error.add_note(f"record {number}, {name}: {what}")
            raise
        if name == "read" and not answered[name]:
            return dict.fromkeys(READERS, False)
    return answered
