"""Runs that are cut short: functions in place of machines whose metrics grow evenly with time."""

from functions import NODE, FunctionBackend, make_study

from bo_tuner.metrics.collect import cut_short

LENGTH = 10.0
"""Time of a whole run [s]."""

GROWS = NODE | {"grows": True}


def short_study(cut=True, **sections):
    """A study of `error` and `peak`, which only grow."""
    budget = {"trials": 14, "initial_trials": 8, "drawn_contexts": 2, "search_evaluations": 1}
    sections = {"metrics": {"error": GROWS, "peak": GROWS}} | sections
    return make_study(budget=budget | {"cut_short": cut, "validation_draws": 3}, **sections)


class EndingBackend(FunctionBackend):
    """Ends a run where a metric of the function is beyond its bound."""

    def __init__(self, study, function):
        super().__init__(study, function)
        self.planned = []

    def outcome(self, planned):
        self.planned.append(planned)
        whole = super().outcome(planned)
        beyond = {n: m for n, m in planned.beyond.items() if whole.metrics.get(n, m) > m}
        if not beyond:
            return whole
        share = min(most / whole.metrics[name] for name, most in beyond.items()) * 1.001
        so_far = {name: share * value for name, value in whole.metrics.items()}
        return cut_short(self._study, planned.beyond, share * LENGTH, so_far, {})
