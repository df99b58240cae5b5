"""What the live page costs a run, and how soon it shows a trial.

Pairs of runs of one study with the same seed in process, one without a page and one with a page
that a client follows all the time, in turns. The cost is the ratio of the times from the first to
the last event of the tuning and the validation: by the clock, and of the processor time of the
run's own process, which other programs hardly stretch. The delay of a trial is the time from its
event until the client has it: in the present state, and in the table of trials.
"""

import http.client
import json
import math
import os
import re
import statistics
import tempfile
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from common import (
    check_end,
    events,
    provenance,
    result_parser,
    start_tuning,
    table,
    write_result,
)

ADDRESS = re.compile(r"http://127\.0\.0\.1:(\d+)/\?token=([\w-]+)")
TRIALS = re.compile(r">(\d+) trials<")
CLOCK_TICK = os.sysconf("SC_CLK_TCK")


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
            if found := TRIALS.search(answer["sections"].get("trials", "")):
                self.section.setdefault(int(found[1]), arrived)
            if answer["complete"]:
                return


def processor_seconds(pid: int) -> float:
    """Processor time of a process so far, without that of its children."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / CLOCK_TICK


def run(study: str, trials: int, seed: int, folder: Path, *, web: bool) -> dict[str, Any]:
    """Run a study; return its times, and the delays of the page's trials."""
    process = start_tuning(
        *("--backend", "inprocess", "--study", study, "--trials", str(trials)),
        *("--seed", str(seed), "--output", str(folder), *(["--web"] if web else [])),
    )
    follower, times = None, {}
    begun = ended = began_with = ended_with = 0.0
    for event in events(process):
        kind = event["event"]
        if kind == "message" and (seen := ADDRESS.search(event["text"])):
            follower = Follower(int(seen[1]), seen[2])
            follower.start()
        elif kind == "phase" and event["phase"] == "tuning":
            begun, began_with = event["time"], processor_seconds(process.pid)
        elif kind == "trial":
            times[event["trial"] + 1] = event["time"]
        elif kind == "result":
            ended, ended_with = event["time"], processor_seconds(process.pid)
    check_end(process.wait())
    found = {"clock": ended - begun, "processor": ended_with - began_with}
    if follower is None:
        return found
    follower.join(60.0)
    return found | follower.delays(times) | {"trials_in_table": len(follower.section)}


def main() -> None:
    """Measure and report."""
    parser = result_parser(__doc__, "web_overhead.json")
    parser.add_argument("--study", default="benchmark", help="(default: %(default)s)")
    parser.add_argument("--trials", type=int, default=30, help="(default: %(default)s)")
    parser.add_argument("--pairs", type=int, default=5, help="(default: %(default)s)")
    arguments = parser.parse_args()
    if arguments.pairs < 2:
        parser.error("--pairs: expected at least 2, so that the costs have an error")
    about = provenance()
    load = [os.getloadavg()[0]]
    pairs = []
    for seed in range(1, arguments.pairs + 1):
        pair = {}
        with tempfile.TemporaryDirectory() as name:
            # In turns, so that neither always comes first.
            for web in (False, True) if seed % 2 else (True, False):
                pair["with" if web else "without"] = run(
                    arguments.study, arguments.trials, seed, Path(name), web=web
                )
        pairs.append(pair)
        load.append(os.getloadavg()[0])
    rows = []
    result: dict[str, Any] = {
        "provenance": about, "study": arguments.study, "trials": arguments.trials,
        "load_average": load, "pairs": pairs,
    }  # fmt: skip
    for kind in ("clock", "processor"):
        logs = [math.log(p["with"][kind] / p["without"][kind]) for p in pairs]
        mean = statistics.fmean(logs)
        error = statistics.stdev(logs) / math.sqrt(len(logs))
        result[f"cost_by_{kind}"] = math.expm1(mean)
        result[f"standard_error_by_{kind}"] = error
        rows.append((f"cost by {kind}", f"{100 * math.expm1(mean):+.1f} % ± {100 * error:.1f} %"))
    for kind in ("delay_of_state", "delay_of_table"):
        delays = sorted(delay for pair in pairs for delay in pair["with"][kind])
        result[kind] = {"median": statistics.median(delays), "largest": delays[-1]}
        rows.append((kind, f"median {statistics.median(delays):.2f} s, largest {delays[-1]:.2f} s"))
    write_result(arguments.result, result)
    print(table(("", "geometric mean of the ratios ± standard error"), rows))


if __name__ == "__main__":
    main()
