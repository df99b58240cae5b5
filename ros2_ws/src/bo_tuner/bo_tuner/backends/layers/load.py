"""How busy the computer was during a run, and what it may be blamed for."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from time import monotonic

from bo_tuner.backends.layers.layer import Layer, Run
from bo_tuner.processor_load import LoadMeter, busy_in_words, explains
from bo_tuner.run_notes import Unusable
from bo_tuner.text import brief
from bo_tuner.trials import Evaluation, EvaluationState, Outcome


def measured(processes: Callable[[], Iterable[int]]) -> Layer:
    """Measure the load during each run, which is performed by these processes, as far as known."""

    def layer(run: Run) -> Run:
        def measured_run(planned: Evaluation) -> Outcome:
            begin, meter = monotonic(), LoadMeter(processes())
            outcome = run(planned)
            outcome = replace(outcome, load=meter.load(processes()))
            return weighed(outcome, monotonic() - begin)

        return measured_run

    return layer


def weighed(outcome: Outcome, seconds: float) -> Outcome:
    """Return the outcome of a run that took so long [s]: a gap may be the fault of the computer."""
    gap, failed = outcome.notes.gap, outcome.state is EvaluationState.FAILED
    if gap is None or not failed or not explains(outcome.load, gap, seconds):
        return outcome
    reason = brief(f"{outcome.reason}; {busy_in_words(outcome.load)}")
    return replace(outcome, reason=reason).noted(unusable=Unusable.DISTURBED)
