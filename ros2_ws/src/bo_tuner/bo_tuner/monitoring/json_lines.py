"""A run as JSON lines on standard output: one object for each event, for other programs."""

import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO

from bo_tuner.codec.writing import to_json
from bo_tuner.evidence.words.verdict import reasons
from bo_tuner.methods.stopping import StopAdvice
from bo_tuner.monitoring.display import Display, Result
from bo_tuner.monitoring.status import RunStatus
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.study.limits import outcome_in_words
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Trial, TrialState

SCHEMA = 1


class JsonLines(Display):
    """Writes each event as a line; warnings are also written to standard error.

    If the reader closes the pipe, the run continues without this output.
    """

    def __init__(self, study: Study, status: RunStatus, out: TextIO | None = None) -> None:
        super().__init__()
        self._study = study
        self._status = status
        self._out: TextIO | None = out or sys.stdout

    def start(self, folder: Path, backend: str, algorithm: str) -> None:
        """Write the event ``run``."""
        study = self._study
        self._write(
            "run",
            schema=SCHEMA,
            study=study.name,
            folder=str(folder),
            backend=backend,
            algorithm=algorithm,
            seed=study.seed,
            trials=study.budget.trials,
            objective={"metric": study.objective.metric, "direction": study.objective.direction},
            units={name: metric.unit for name, metric in study.metrics.items()},
        )

    def begin(self, phase: str, total: int) -> None:
        """Write the event ``phase``."""
        self._write("phase", phase=phase, total=total, time_left=self._status.now.time_left)

    def recall(self, trials: Sequence[Trial], incumbent: Candidate | None) -> None:
        """Write an event ``trial`` for each recorded trial."""
        for trial in trials:
            self._write("trial", recalled=True, **self._of_trial(trial))

    def evaluation(self, evaluation: Evaluation) -> None:
        """Write the event ``evaluation``."""
        outcome = evaluation.outcome
        self._write(
            "evaluation",
            trial=evaluation.trial,
            index=evaluation.index,
            stage=str(evaluation.stage),
            parameters=self._study.as_given(evaluation.parameters),
            context=evaluation.context,
            seed=evaluation.seed,
            state=str(outcome.state),
            reason=outcome.reason,
            note=outcome.notes.remark,
            metrics=outcome.metrics,
            seconds=evaluation.seconds,
        )

    def trial(self, trial: Trial, incumbent: Candidate | None) -> None:
        """Write the event ``trial``, with the incumbent."""
        now = self._status.now
        best = incumbent and {
            "trial": incumbent.trial.number,
            "objective": incumbent.objective,
            "probability_feasible": incumbent.feasibility,
            "believed_feasible": incumbent.believed_feasible,
        }
        self._write(
            "trial",
            recalled=False,
            **self._of_trial(trial),
            incumbent=best,
            overhead=now.overhead,
            time_left=now.time_left,
        )

    def advise(self, advice: StopAdvice) -> None:
        """Write the event ``stop_advice``."""
        self._write("stop_advice", **to_json(advice))

    def pause(self, paused: bool) -> None:
        """Write the event ``pause``."""
        self._write("pause", paused=paused)

    def inform(self, text: str) -> None:
        """Write the event ``message`` with a line of information."""
        self._write("message", level="info", text=text)

    def warn(self, text: str) -> None:
        """Write the event ``message`` with a warning, and the warning to standard error."""
        self._write("message", level="warning", text=text)
        super().warn(text)

    def result(self, result: Result) -> None:
        """Write the event ``result``."""
        self._write(
            "result",
            parameters_file=str(result.parameters_file),
            problem="; ".join(reasons(result.verdict)),
            **result.summary,
        )

    def finish(self, code: int) -> None:
        """Write the event ``end``."""
        self._write("end", exit_code=code)

    def _of_trial(self, trial: Trial) -> dict[str, object]:
        metrics = {}
        if trial.state is TrialState.COMPLETE:
            means = {name: trial.mean(name) for name in self._study.metrics}
            metrics = {name: mean for name, mean in means.items() if mean is not None}
        return {
            "trial": trial.number,
            "origin": trial.origin,
            "state": str(trial.state),
            "reason": trial.reason,
            "verdict": outcome_in_words(self._study, trial),
            "parameters": self._study.as_given(trial.parameters),
            "mean_metrics": metrics,
            "worst_cases": trial.worst_cases,
            "evaluations": len(trial.evaluations),
            "optimizer_seconds": trial.seconds,
            "evaluation_seconds": sum(evaluation.seconds for evaluation in trial.evaluations),
            "warnings": list(trial.warnings),
        }

    def _write(self, event: str, **fields: object) -> None:
        if self._out is None:
            return
        content = to_json({"event": event, "time": time.time(), **fields})
        line = json.dumps(content, allow_nan=False)
        try:
            self._out.write(f"{line}\n")
            self._out.flush()
        except OSError as error:
            # The stream still buffers what it could not write, and would try again at exit.
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._out.fileno())
            os.close(nowhere)
            self._out = None
            super().warn(f"no more JSON lines: {error.strerror}; the run continues")
