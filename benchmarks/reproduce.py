"""Run tasks of a campaign again with the installed code, and compare the results with the records.

Of a run that is what published records keep: the answer, its truth and validation, and the truth of
each incumbent. It must be identical to the last bit, except for measured times. It depends on the
versions of the libraries and on the kernels of the linear algebra, too: see docs/campaigns.md.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from common import BENCHMARKS

from bo_tuner.errors import OutputError, RunError, StudyError
from tuning_benchmark.campaign.records import Records
from tuning_benchmark.campaign.tasks import carry_out, tasks_of
from tuning_benchmark.experiments.experiment_file import load_experiment
from tuning_benchmark.pages.published import reduced

RECORDS = BENCHMARKS.parent / "docs" / "records"

TIMES = ("seconds", "measured")
"""Keys of a result that hold measured times."""

EXIT_OK, EXIT_USAGE, EXIT_DIFFERENT = 0, 2, 3


def differences(recorded: object, now: object, path: str = "") -> Iterator[str]:
    """Yield a line for each key whose values differ, without those of `TIMES`."""
    if isinstance(recorded, Mapping) and isinstance(now, Mapping):
        for key in sorted({*recorded, *now} - {*TIMES}):
            here = f"{path}.{key}" if path else key
            if key not in now or key not in recorded:
                yield f"{here}: only {'on record' if key in recorded else 'now'}"
            else:
                yield from differences(recorded[key], now[key], here)
    elif isinstance(recorded, list) and isinstance(now, list) and len(recorded) == len(now):
        for index, (old, new) in enumerate(zip(recorded, now, strict=True)):
            yield from differences(old, new, f"{path}[{index}]")
    elif recorded != now:
        yield f"{path or 'result'}: {recorded} on record, {now} now"


def reproduce(name: str, folder: Path, patterns: list[str]) -> bool:
    """Run the tasks of an experiment that match; return whether all are identical.

    Raises
    ------
    StudyError, OutputError
        If the experiment or the records cannot be read, or a pattern matches no task on record.
    RunError
        If a module that a task imports is not installed.
    """
    experiment = load_experiment(name)
    tasks = {task.name: task for task in tasks_of(experiment)}
    path = folder / f"{experiment.name}.jsonl"
    records = Records(path, {task.name: task.version for task in tasks.values()}, any_version=True)
    for pattern in patterns:
        if not any(fnmatchcase(task, pattern) for task in records.done):
            raise OutputError(f"{path}: no task matches {pattern}")
    same = True
    for task in tasks.values():
        record: Mapping[str, Any] | None = records.done.get(task.name)
        if record is None or not any(fnmatchcase(task.name, pattern) for pattern in patterns):
            continue
        again = json.loads(json.dumps(carry_out(task)))
        # What published records keep.
        record, again = (reduced(experiment, {task.name: r})[task.name] for r in (record, again))
        found = [
            line
            for key in ("failed", "result")
            for line in differences(record[key], again[key], "" if key == "result" else key)
        ]
        same = same and not found
        print(f"{task.name}: {'; '.join(found) if found else 'identical'}", flush=True)
        if found:
            print(_origin("on record", record), _origin("now", again), sep="\n", flush=True)
    return same


def _origin(when: str, record: Mapping[str, Any]) -> str:
    return f"  {when}: {record['about']['machine']}; {record['about']['versions']}"


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(
        description=__doc__,
        epilog="exit codes: 0 all identical, 2 bad input, 3 a result differs",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "tasks",
        nargs="+",
        metavar="TASK",
        help="name of a task, such as run/benchmark/IV/1, or a pattern, such as 'run/full/*/1'",
    )
    parser.add_argument(
        "--experiment",
        default="paper",
        metavar="NAME|FILE",
        help="shipped experiment or path of a file (default: %(default)s)",
    )
    parser.add_argument(
        "--records",
        type=Path,
        default=RECORDS,
        metavar="DIR",
        help="folder of the records (default: docs/records)",
    )
    arguments = parser.parse_args()
    try:
        same = reproduce(arguments.experiment, arguments.records, arguments.tasks)
    except (StudyError, OutputError, RunError) as error:
        sys.stderr.write(f"error: {error}\n")
        sys.exit(EXIT_USAGE)
    sys.exit(EXIT_OK if same else EXIT_DIFFERENT)


if __name__ == "__main__":
    main()
