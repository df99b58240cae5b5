"""Records for publication: what the page and its tables read, and no more.

The neighbours of answers and the truth of incumbents are most of a record, and little of them is
read. A reduced record makes the same page as the whole one; a campaign can go on with it, too.
"""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from bo_tuner.storage.atomic import write_atomically, writing
from tuning_benchmark.experiments.experiment import Experiment
from tuning_benchmark.experiments.task_names import run_task
from tuning_benchmark.pages.summary import Record

SHOWN = ("objective", "feasible")
"""Of a truth, for most tables."""
WORST = ("worst", "worst_kept", "worst_context")
"""Of the truth of an answer, too; certificates of recorded answers begin at its worst context."""
RUN = ("cuts", "check_cuts", "trajectory", "seconds")
ANSWER = ("believed", "training", "parameters")


def publish(experiment: Experiment, done: Mapping[str, Record], path: Path) -> Path:
    """Write the reduced records of an experiment to a file, a line each, and return its path.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    lines = reduced(experiment, done).values()
    text = "".join(json.dumps(line, separators=(",", ":")) + "\n" for line in lines)
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    return write_atomically(path, text)


def reduced(experiment: Experiment, done: Mapping[str, Record]) -> dict[str, Record]:
    """Return records of an experiment by task, those of runs with what is read of them."""
    # The tables also list the neighbours of the best answers if a case has judged parameter sets.
    neighbours_listed = {
        run_task(case.name, row, seed): bool(case.points)
        for case in experiment.cases.values()
        for row in case.rows
        for seed in range(1, case.runs + 1)
    }
    return {
        name: {**record, "result": _result(record["result"], neighbours_listed[name])}
        if name in neighbours_listed and record["result"]
        else record
        for name, record in done.items()
    }


def _result(result: Record, listed: bool) -> dict[str, Any]:
    answer, ranked = result["answer"], result["ranked"]
    return _only(result, RUN) | {
        "incumbents": {
            number: _only(truth, SHOWN) for number, truth in result["incumbents"].items()
        },
        "ranked": ranked and {"truth": _only(ranked["truth"], SHOWN)},
        "answer": answer and _answer(answer, listed),
    }


def _answer(answer: Record, listed: bool) -> dict[str, Any]:
    return _only(answer, ANSWER) | {
        "validation": _only(answer["validation"], SHOWN),
        "truth": _only(answer["truth"], (*SHOWN, *WORST)),
        "neighbours": [_neighbour(neighbour, listed) for neighbour in answer["neighbours"]],
    }


def _neighbour(neighbour: Record, listed: bool) -> dict[str, Any]:
    kept = _only(neighbour, ("changed", "tolerable"))
    if not listed:
        return kept
    truth = _only(neighbour["truth"], (*SHOWN, "worst"))
    return kept | {"parameters": neighbour["parameters"], "truth": truth}


def _only(value: Record, keys: Iterable[str]) -> dict[str, Any]:
    return {key: value[key] for key in keys if key in value}
