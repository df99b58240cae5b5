"""A machine of ten lines, for what is around a run: it has its own time, and ends as it is told."""

from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage

COMPLETE = Outcome(EvaluationState.COMPLETE, {"error": 1.0})
FAILED = Outcome(EvaluationState.FAILED, reason="stalled")
PLANNED = Evaluation(3, 1, Stage.DRAWN, {"gain": 0.75}, {"load": 1.5}, 7)


class Machine:
    """Runs take `takes` seconds, and have the outcomes given, then complete ones."""

    def __init__(self, *outcomes):
        self.now = 0.0
        self.takes = 1.0
        self.ran = []
        self._outcomes = list(outcomes)

    def clock(self):
        return self.now

    def run(self, planned):
        self.ran.append(planned)
        self.now += self.takes
        return self._outcomes.pop(0) if self._outcomes else COMPLETE
