"""A run of many trials, made in a minute, and its live page while it goes on.

The trials are drawn at random, and their metrics are those of a formula: a page does not care what
they mean, and neither nodes nor proposals take time. The last trials are run by `tune --resume`, as
of any interrupted run, with a page that a browser and a client look at.
"""

import http.client
import json
import os
import re
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from common import BENCHMARKS, check_end, events, start_tuning

from bo_tuner.methods.registry import METHODS
from bo_tuner.storage.journal import Journal
from bo_tuner.storage.provenance import session_provenance
from bo_tuner.storage.run_folder import RunFolder
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import load_study
from bo_tuner.trials import Evaluation, EvaluationState, Outcome
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.journaling import JournalObserver
from bo_tuner.tuning.loop import Tuning

# The browser is driven as in the tests.
sys.path.append(str(BENCHMARKS.parent / "tests" / "browser"))
from chromium import Chromium

ADDRESS = re.compile(r"http://127\.0\.0\.1:(\d+)/\?token=([\w-]+)")
LATEST = re.compile(r'<tbody>\s*<tr[^>]*>\s*<th scope="row">(\d+)')
"""The trial at the top of the table of the latest ones."""
ALGORITHM = "II"
ROWS = "document.querySelectorAll('#trials tbody tr').length > 0"
ANSWERED = "document.querySelector('#answer h2') !== null"


class Follower(threading.Thread):
    """Asks for what is new until the page is gone; notes when it has what of each trial."""

    def __init__(self, port: int, token: str) -> None:
        super().__init__(daemon=True)
        self.state: dict[int, float] = {}
        self.section: dict[int, float] = {}
        self._port, self._token = port, token

    def delays(self, times: Mapping[int, float]) -> dict[str, list[float]]:
        """How long after its event the client had each trial: in the state, and in the table."""
        return {
            f"delay_of_{name}": [had[trial] - at for trial, at in times.items() if trial in had]
            for name, had in (("state", self.state), ("table", self.section))
        }

    def run(self) -> None:
        """Ask until the page is complete or gone."""
        version = -1
        while True:
            connection = http.client.HTTPConnection("127.0.0.1", self._port, timeout=60.0)
            try:
                connection.request("GET", f"/state?after={version}&token={self._token}")
                answer = json.loads(connection.getresponse().read())
            except (OSError, http.client.HTTPException):
                return
            finally:
                connection.close()
            arrived = time.time()
            version = answer["version"]
            if answer["now"].get("trials"):
                self.state.setdefault(answer["now"]["trials"], arrived)
            if found := LATEST.search(answer["sections"].get("trials", "")):
                # Trials are numbered from 0, and counted from 1.
                self.section.setdefault(int(found[1]) + 1, arrived)
            if answer["complete"]:
                return


class Formula:
    """A backend of metrics that are a smooth function of the parameters, with noise."""

    name = "inprocess"

    def __init__(self, study: Study) -> None:
        self._study = study
        self._space = study.search_space()

    def open(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""

    def run(self, evaluations: Iterable[Evaluation]) -> Iterator[Evaluation]:
        """Give each evaluation its metrics."""
        for planned in evaluations:
            away = self._space.to_cube(planned.parameters) - 0.4
            noise = 1.0 + 0.05 * np.random.default_rng(planned.seed).standard_normal()
            value = noise * (0.1 + float(away @ away)) * sum(map(float, planned.context.values()))
            limits = {c.metric: c.limit for c in self._study.constraints.values()}
            metrics = {name: value * limits.get(name, 1.0) for name in self._study.metrics}
            outcome = Outcome(EvaluationState.COMPLETE, metrics)
            yield replace(planned, outcome=outcome, seconds=1e-3)


def make_run(folder: Path, name: str, trials: int, more: int) -> Path:
    """Write a run with so many trials, which has `more` to go."""
    study = load_study(name).replace(
        trials=trials + more, drawn_contexts=2, search_evaluations=3, validation_draws=5
    )
    run = RunFolder.create(folder, study)
    try:
        provenance = session_provenance(study, "inprocess", ALGORITHM)
        with Journal(run.journal, provenance) as journal:
            tuning = Tuning(
                study, Driver(Formula(study), JournalObserver(journal)), METHODS[ALGORITHM]
            )
            for trial in tuning:
                journal.record_trial(trial)
                if len(tuning.trials) == trials:
                    break
        run.write_study(study)
    finally:
        run.close()
    return run.path


def finish_live(run: Path, trials: int) -> Mapping[str, Any]:
    """Finish a run with so many trials on record, and return how soon its live page shows what.

    Returns the seconds until the page is loaded, has the table of trials, and the answer, all since
    it was asked for; and the seconds from the end of each further trial until the client has it.
    """
    process = start_tuning("--resume", str(run), "--web")
    times: dict[int, float] = {}
    recalled, found = threading.Event(), []
    address: list[tuple[int, str]] = []

    def read() -> None:
        for event in events(process):
            if event["event"] == "message" and (seen := ADDRESS.search(event["text"])):
                address.append((int(seen[1]), seen[2]))
            elif event["event"] == "trial" and event["recalled"]:
                if event["trial"] + 1 == trials:
                    recalled.set()
            elif event["event"] == "trial":
                times[event["trial"] + 1] = event["time"]

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    if not recalled.wait(300.0):
        raise SystemExit("error: the run did not go on")
    ((port, token),) = address
    follower = Follower(port, token)
    follower.start()
    with tempfile.TemporaryDirectory() as profile, Chromium(Path(profile)) as browser:
        browser.open("about:blank")
        begin = time.monotonic()
        browser.call("Page.navigate", url=f"http://127.0.0.1:{port}/?token={token}")
        for condition in ("document.readyState === 'complete'", ROWS, ANSWERED):
            browser.wait_for(condition, timeout=300.0)
            found.append(time.monotonic() - begin)
        process.wait()
        follower.join(120.0)
    reader.join(10.0)
    check_end(process.returncode)
    loaded, table, answer = found
    return {
        "seconds_to_load": loaded,
        "seconds_to_table": table,
        "seconds_to_answer": answer,
        **follower.delays(times),
        "load_average": os.getloadavg(),
    }
