"""How many runs in a minute a bag gives that is played in lockstep.

    python benchmarks/playing.py                5 runs of a drive of 60 s
    python benchmarks/playing.py --seconds 30 --repeats 3

The drive and the filter of `examples/estimators`, as a node that is started anew for each run.
Beside it the same bag by the clock, at rate 1: as often as any player that keeps its time.
"""

import dataclasses
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from common import opened, provenance, result_parser, table, write_result

from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.study.study_file import parse_study
from bo_tuner.trials import Evaluation, Stage

sys.path.append(str(Path(__file__).parents[1] / "examples/estimators"))
import make_drives

EXAMPLE = Path(make_drives.__file__).parent
LOCKSTEP, BY_CLOCK = "in lockstep", "at rate 1"
PLAY = {LOCKSTEP: "", BY_CLOCK: ", lockstep: false, rate: 1"}


def backend(folder: Path, bag: Path, how: str) -> RosBackend:
    """Return a backend for the study of the example, which plays a bag in one way."""
    text = (EXAMPLE / "study.yaml").read_text(encoding="utf-8")
    text = text.replace('play: "{drive}"', f"play: {{bag: {bag}{PLAY[how]}}}")
    text = text.replace('contexts:\n  drive: {bags: ["drives/*"]}\n', "")
    return RosBackend(dataclasses.replace(parse_study(text), folder=str(EXAMPLE)), folder)


def seconds_of_runs(made: RosBackend, repeats: int) -> list[float]:
    """Return the times [s] of runs, the new start of the node included."""
    found = []
    for index in range(repeats):
        values = {"speed_noise": 0.3, "bias_walk": 0.01, "fix_noise": 0.4 + 0.01 * index}
        begun = time.monotonic()
        outcome = made.outcome(Evaluation(0, index, Stage.DRAWN, values, {}, 1))
        found.append(time.monotonic() - begun)
        if not outcome.complete:
            raise RuntimeError(outcome.reason)
    return found


def main() -> None:
    """Play and report."""
    parser = result_parser(__doc__ or "", "playing.json")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    result: dict[str, Any] = {"provenance": provenance(), "seconds": arguments.seconds}
    with tempfile.TemporaryDirectory() as name:
        bag = Path(name, "drive")
        make_drives.write(bag, 1, arguments.seconds)
        runs = {}
        for how, repeats in ((LOCKSTEP, arguments.repeats), (BY_CLOCK, 1)):
            with opened(backend(Path(name), bag, how)) as made:
                runs[how] = seconds_of_runs(made, repeats)
    rows = [(how, f"{60.0 / statistics.median(found):.2f}") for how, found in runs.items()]
    print(table(("", "runs in a minute"), rows))
    write_result(arguments.result, result | {"runs": runs})


if __name__ == "__main__":
    main()
