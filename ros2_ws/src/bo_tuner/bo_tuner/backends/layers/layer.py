"""A need of a machine as a function around a run."""

from collections.abc import Callable

from bo_tuner.trials import Evaluation, Outcome

Run = Callable[[Evaluation], Outcome]
"""Carries out a planned evaluation; a fault of a node or a simulation is an outcome."""
Layer = Callable[[Run], Run]
"""Returns a run in whose place one is carried out, or not, with what is needed around it."""


def stacked(run: Run, *layers: Layer) -> Run:
    """Return a run with layers around it, from the innermost to the outermost."""
    for layer in layers:
        run = layer(run)
    return run
