"""Runs that warm a machine up ahead of others, and count nothing."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from time import monotonic

from bo_tuner.backends.layers.layer import Layer, Run
from bo_tuner.numerics.seeds import Stream, noise_seed
from bo_tuner.run_notes import Unusable
from bo_tuner.study.study import Study
from bo_tuner.text import brief
from bo_tuner.trials import Evaluation, Outcome, Stage


def warm_up_runs(study: Study, count: int) -> list[Evaluation]:
    """Return runs with the parameters that the search begins with, as the most trusted ones."""
    parameters = next(iter(study.starting_sets()), study.search_space().defaults)
    contexts = study.context_space()
    nominal = contexts.to_dict(contexts.nominal())
    seeds = (noise_seed(study.seed, Stream.NOISE, 0, k) for k in range(count))
    return [
        Evaluation(0, k, Stage.NOMINAL, parameters, nominal, seed) for k, seed in enumerate(seeds)
    ]


def warmed_up(
    runs: Sequence[Evaluation],
    after: float,
    by: Run,
    ended: Callable[[], object],
    clock: Callable[[], float] = monotonic,
) -> Layer:
    """Have `runs` made `by` a cold machine first, each of which `ended` is told of.

    It is cold at first, and after a break of more than `after` [s]. Where a run with the most
    trusted parameters fails, nothing is known of those of an evaluation, which is not made then.
    """
    warm_until = -math.inf

    def layer(run: Run) -> Run:
        def warmed(planned: Evaluation) -> Outcome:
            nonlocal warm_until
            begin = clock()
            due = runs if begin > warm_until else ()
            for k, warming in enumerate(due, 1):
                outcome = by(warming)
                ended()
                if not outcome.complete:
                    return _fault(outcome, f"run {k} of {len(due)} to warm up")
            seconds = round(clock() - begin, 3)
            outcome = run(planned)
            warm_until = clock() + after
            return outcome.noted(warm_ups=len(due), warm_up_seconds=seconds) if due else outcome

        return warmed

    return layer


def _fault(outcome: Outcome, where: str) -> Outcome:
    """Return what an evaluation is ahead of which a run has failed."""
    unusable = outcome.notes.unusable if outcome.unusable else Unusable.UNPREPARED
    fault = replace(outcome, reason=brief(f"{where}: {outcome.reason}"))
    return fault.noted(unusable=unusable, death=None)
