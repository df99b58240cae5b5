"""100 times kill -9 of tune and validate over ROS, half of them at what they write in the end.

A run of short cuts is killed again and again: at any moment of ``tune`` and ``validate``, and in
the second after summary, bundle or certificate has begun to be there (what is there of summary and
bundle is deleted before, so that it is written anew). Each time the same command begins again, the
tuner by ``--resume`` as soon as there is something on record. At its end each run is resumed,
certified and reported without a kill, and the next one begins.

A command that ends by itself with another code than that of a result has refused to go on. A row is
wrong if it differs from that of a run which nobody has killed.
"""

import contextlib
import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from common import A_RESULT, provenance, result_parser, start_command, table, write_result

from bo_tuner.run_notes import Notes
from bo_tuner.storage.record import read_run
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import (
    load_study,
    study_from_mapping,
    study_to_mapping,
    study_to_yaml,
)
from bo_tuner.trials import Evaluation

SEED = 1
ANY = "at any moment"
SUMMARY, BUNDLE, CERTIFICATE = "after the summary", "after the bundle", "after the certificate"
AWAITED = {SUMMARY: "summary.json", BUNDLE: "deploy", CERTIFICATE: "certificates/*.json"}
"""By moment, what of the run folder is awaited first."""
LIFE = (
    ("tune", ANY),
    ("tune", ANY),
    ("tune", SUMMARY),
    ("tune", BUNDLE),
    ("tune", SUMMARY),
    ("tune", BUNDLE),
    ("validate", ANY),
    ("validate", CERTIFICATE),
    ("validate", ANY),
    ("validate", CERTIFICATE),
)
"""Kills of a run, in turn: the command and the moment."""
LONGEST_DELAY = 1.0
"""Longest time [s] between what is awaited and the kill."""
LONGEST_WAIT = 180.0


class Run:
    """A run in a folder of its own."""

    def __init__(self, folder: Path, study: Study) -> None:
        folder.mkdir()
        (folder / "study.yaml").write_text(study_to_yaml(study))
        self._folder = folder
        self.refused: list[str] = []

    @property
    def path(self) -> Path:
        """Its run folder, if there is one."""
        return self._folder / "runs" / "latest"

    def begin(self, command: str) -> subprocess.Popen:
        """Start a command on the run."""
        arguments = {
            "tune": ["--resume", str(self.path)] if self._is_on_record() else self._anew(),
            "validate": [str(self.path)],
            "report": [str(self.path)],
        }[command]
        return start_command(self._folder, command, *arguments)

    def finish(self, command: str) -> float:
        """Run a command to its end; returns the seconds that it took."""
        begin = time.monotonic()
        self._judge(command, self.begin(command).wait())
        return time.monotonic() - begin

    def kill(self, command: str, moment: str, delay: float) -> bool:
        """Kill a command so long [s] after a moment has come; False if it has ended."""
        if moment in (SUMMARY, BUNDLE):
            (self.path / "summary.json").unlink(missing_ok=True)
            shutil.rmtree(self.path / "deploy", ignore_errors=True)
        before = self._count(moment)
        process = self.begin(command)
        deadline = time.monotonic() + LONGEST_WAIT
        while moment != ANY and self._count(moment) <= before and process.poll() is None:
            if time.monotonic() > deadline:
                process.kill()
                raise SystemExit(f"error: no {AWAITED[moment]} for {LONGEST_WAIT:g} s")
            time.sleep(0.001)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._judge(command, process.wait(delay))
            return False
        process.kill()
        process.wait()
        return True

    def rows(self) -> list[Evaluation]:
        """Read all evaluations, without what is of the moment: times, and numbers of cuts."""
        rows = read_run(self.path).evaluations
        return [
            replace(row, seconds=0.0, outcome=replace(row.outcome, details={}, notes=Notes()))
            for row in rows
        ]

    def left_over(self) -> int:
        """Count the files that a write left half done."""
        return len(list(self.path.resolve().rglob(".*.new")))

    def _judge(self, command: str, code: int) -> None:
        if code not in A_RESULT:
            said = (self._folder / "output").read_text().splitlines()
            self.refused.append(f"{command}: exit code {code}: {said[-1] if said else ''}")

    def _count(self, moment: str) -> int:
        return len(list(self.path.glob(AWAITED[moment]))) if moment != ANY else 0

    def _is_on_record(self) -> bool:
        with contextlib.suppress(sqlite3.Error, OSError):
            uri = (self.path.resolve(strict=True) / "journal.sqlite").as_uri()
            with contextlib.closing(sqlite3.connect(f"{uri}?mode=ro", uri=True)) as db:
                return db.execute("SELECT count(*) FROM session").fetchone()[0] > 0
        return False

    @staticmethod
    def _anew() -> list[str]:
        return ["--study", "study.yaml"]


@dataclass
class Life:
    """What became of a run."""

    kills: Counter[str] = field(default_factory=Counter)
    refused: list[str] = field(default_factory=list)
    rows: list[Evaluation] = field(default_factory=list)
    left_over: int = 0


def short_study() -> Study:
    """Take the benchmark study with few and short cuts, without any measured time."""
    mapping = study_to_mapping(load_study("benchmark"))
    mapping["nodes"]["controller"]["parameters"] = {"return_time": "modelled"}
    mapping["nodes"]["plant"]["parameters"] = {
        "reference_levels": [0.0, 0.5],
        "samples_per_level": 10,
    }
    # A worst-case constraint would make a certificate take hundreds of cuts.
    overshoot = {"kind": "chance", "metric": "overshoot", "upper": 0.09, "probability": 0.9}
    mapping["constraints"]["overshoot"] = overshoot
    mapping["certificate"] = {"draws": 20, "confidence": 0.5}
    return study_from_mapping(mapping).replace(
        trials=4, initial_trials=3, drawn_contexts=2, search_evaluations=1, validation_draws=3
    )


def life(folder: Path, study: Study, seconds: Mapping[str, float], number: int) -> Life:
    """Kill a run as often as `LIFE` tells, and bring it to its end."""
    rng = np.random.default_rng([SEED, number])
    run, found = Run(folder / str(number), study), Life()
    for command, moment in LIFE:
        delay = rng.uniform(0.0, seconds[command] if moment == ANY else LONGEST_DELAY)
        if run.kill(command, moment, delay):
            found.kills[f"{command} {moment}"] += 1
    for command in ("tune", "validate", "report"):
        run.finish(command)
    found.refused, found.rows, found.left_over = run.refused, run.rows(), run.left_over()
    return found


def soak(count: int, jobs: int, folder: Path) -> Iterator[dict[str, Any]]:
    """Kill at least so often, in so many runs side by side; gives the figures after each run."""
    study = short_study()
    whole = Run(folder / "whole", study)
    seconds = {command: whole.finish(command) for command in ("tune", "validate")}
    if whole.refused:
        raise SystemExit(f"error: without any kill: {whole.refused}")
    expected = whole.rows()
    lives: list[Life] = []
    numbers = iter(range(sys.maxsize))
    with ThreadPoolExecutor(jobs) as pool:

        def begin() -> Future[Life]:
            return pool.submit(life, folder, study, seconds, next(numbers))

        pending = {begin() for _ in range(jobs)}
        while pending:
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            lives += [future.result() for future in done]
            kills = sum((each.kills for each in lives), Counter())
            if kills.total() + len(pending) * len(LIFE) < count:
                pending |= {begin() for _ in done}
            yield {
                "seed": SEED,
                "jobs": jobs,
                "seconds_without_kills": seconds,
                "kills": dict(kills),
                "ended_before_the_kill": len(lives) * len(LIFE) - kills.total(),
                "runs": len(lives),
                "refused": [line for each in lives for line in each.refused],
                "rows_compared": sum(len(each.rows) for each in lives),
                "wrong_rows": sum(differing(each.rows, expected) for each in lives),
                "files_left_over": sum(each.left_over for each in lives),
                "load_average": os.getloadavg(),
            }


def differing(rows: list[Evaluation], expected: list[Evaluation]) -> int:
    """Count the rows that are not as expected, missing ones included."""
    return sum(a != b for a, b in zip_longest(rows, expected))


def main() -> None:
    """Kill and report; exit code 1 if a command refused to go on or a row is wrong."""
    parser = result_parser(__doc__, "command_kills.json")
    parser.add_argument("--kills", type=int, default=100, help="(default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=1, help="runs at once (default: %(default)s)")
    arguments = parser.parse_args()
    origin = provenance()
    with tempfile.TemporaryDirectory() as name:
        os.environ["XDG_STATE_HOME"] = name
        for result in soak(arguments.kills, arguments.jobs, Path(name)):
            write_result(arguments.result, {"provenance": origin} | result)
            print(table(["killed", "times"], result["kills"].items()))
            print(f"refused: {result['refused']}, wrong rows: {result['wrong_rows']}", flush=True)
    if result["refused"] or result["wrong_rows"]:
        sys.exit(1)


if __name__ == "__main__":
    main()
