"""The runs of a machine at known parameters: of a run folder, or of bags of one."""

import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bo_tuner.errors import RunRecordError
from bo_tuner.recording.retention import custom_data, is_bag
from bo_tuner.storage.record import RunRecord, read_run
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, EvaluationState, ParameterSet, Value, parameter_set

Runs = Mapping[ParameterSet, Sequence[Mapping[str, float]]]
"""The metrics of the runs of each parameter set."""


@dataclass(frozen=True)
class MachineRuns:
    """Complete runs of a machine.

    Attributes
    ----------
    sets
        The metrics of the runs by their parameter set.
    metrics
        What they are compared in: metrics that all of them have and the study, too.
    left_out
        How many runs did not complete.
    """

    sets: Runs
    metrics: tuple[str, ...]
    left_out: int

    @property
    def count(self) -> int:
        """Number of complete runs."""
        return sum(map(len, self.sets.values()))


@dataclass(frozen=True)
class _Run:
    trial: int
    parameters: Mapping[str, Value]
    context: Context
    complete: bool
    metrics: Mapping[str, float]


def machine_runs(
    paths: Sequence[Path],
    study: Study,
    metrics: Sequence[str] | None = None,
    trial: int | None = None,
) -> MachineRuns:
    """Read the runs in run folders or bags, and hold them against the study of the simulator."""
    runs: list[_Run] = []
    times: set[str] = set()
    for path in paths:
        if is_bag(path):
            of_path = list(_of_bag(path))
        else:
            record = read_run(path)
            _check_units(record, study)
            times |= {name for name, item in record.study.metrics.items() if item.measures_time}
            of_path = list(_of_record(record))
        if trial is not None:
            of_path = [run for run in of_path if run.trial == trial]
        for run in of_path:
            _check(path, run, study)
        runs += of_path
    complete = [run for run in runs if run.complete]
    where = " and ".join(map(str, paths))
    if not complete:
        of_trial = "" if trial is None else f" of trial {trial}"
        raise RunRecordError(f"{where}: has no complete run{of_trial}")
    names = _compared(where, study, complete, times, metrics)
    sets: dict[ParameterSet, list[Mapping[str, float]]] = {}
    for run in complete:
        sets.setdefault(parameter_set(run.parameters), []).append(run.metrics)
    return MachineRuns(sets, names, len(runs) - len(complete))


def _compared(
    where: str,
    study: Study,
    runs: Sequence[_Run],
    times: Collection[str],
    asked: Sequence[str] | None,
) -> tuple[str, ...]:
    """Return the metrics to compare: those asked for, or all of the plant that every run has."""
    if asked is None:
        names = [
            name
            for name in study.of_plant
            if name not in times and all(name in run.metrics for run in runs)
        ]
        missing = [] if names else study.of_plant
    else:
        names = list(asked)
        missing = [name for name in names if any(name not in run.metrics for run in runs)]
    if missing:
        raise RunRecordError(
            f"{where}: its runs are of another machine: expected the metric {' or '.join(missing)},"
            f" found {', '.join(runs[0].metrics) or 'none'}"
        )
    return tuple(names)


def _of_record(record: RunRecord) -> Iterator[_Run]:
    for evaluation in record.evaluations:
        outcome = evaluation.outcome
        yield _Run(
            evaluation.trial,
            evaluation.parameters,
            evaluation.context,
            outcome.complete,
            outcome.metrics,
        )


def _of_bag(bag: Path) -> Iterator[_Run]:
    """Yield the runs that a bag of a trial tells of."""
    data = custom_data(bag)
    if "evaluations" not in data:
        raise RunRecordError(
            f"{bag}: the parameters of its runs cannot be read; expected a bag of a run of tune, "
            "in RUN/bags"
        )
    try:
        for item in json.loads(data["evaluations"]):
            parameters, metrics = item["parameters"], item.get("metrics", {})
            yield _Run(
                int(item.get("trial", data.get("trial", 0))),
                {str(name): _value(value) for name, value in parameters.items()},
                dict(item.get("context", {})),
                item.get("state") == EvaluationState.COMPLETE,
                {str(name): float(value) for name, value in metrics.items()},
            )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        shown = str(error)[:200] or repr(error)
        raise RunRecordError(
            f"{bag}: the parameters of its runs cannot be read: {shown}"
        ) from error


def _value(value: object) -> Value:
    if not isinstance(value, (bool, int, float, str)):
        raise TypeError(f"expected a value, found {value!r}")
    return value


def _check(path: Path, run: _Run, study: Study) -> None:
    """Refuse a run of another machine, or one in a context that the tuner has set."""
    if run.context:
        raise RunRecordError(
            f"{path}: the tuner has set a context in its runs ({', '.join(run.context)}); expected "
            "runs of a machine as it is, by a study without contexts"
        )
    missing = [name for name in study.parameters if name not in run.parameters]
    others = [name for name in run.parameters if name not in study.parameters]
    if missing or others:
        parts = [f"no {', '.join(missing)}"] if missing else []
        parts += [f"{', '.join(others)}, which the study does not have"] if others else []
        raise RunRecordError(
            f"{path}: its runs are of another machine: with {' and '.join(parts)}; expected the "
            f"parameters {', '.join(study.parameters)}"
        )


def _check_units(record: RunRecord, study: Study) -> None:
    """Refuse metrics of one name with different units."""
    for name, metric in study.metrics.items():
        other = record.study.metrics.get(name)
        if other is not None and other.unit and metric.unit and other.unit != metric.unit:
            raise RunRecordError(
                f"{record.path}: metric {name} is in {other.unit}; expected {metric.unit}, as in "
                "the study"
            )
