"""The status of a run: shares of time, time left, counts."""

import dataclasses

import pytest

from bo_tuner.methods.registry import METHODS
from bo_tuner.methods.stopping import StopAdvice
from bo_tuner.models.hyperpriors import Hyperparameters
from bo_tuner.monitoring.diagnostics import Level, progress, safety, surrogate, trial_result
from bo_tuner.monitoring.status import RunStatus, Snapshot
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.plans import Event, EventKind, Phase
from bo_tuner.trials import EvaluationState


def timed(trial, proposal, evaluation):
    evaluations = tuple(dataclasses.replace(c, seconds=evaluation) for c in trial.evaluations)
    return dataclasses.replace(trial, seconds=proposal, evaluations=evaluations)


def tell(status, trial, incumbent=None):
    for evaluation in trial.evaluations:
        status.evaluation(evaluation)
    status.trial(trial, incumbent)


def candidate(trial, feasibility=0.9):
    return Candidate(trial, 0.25, feasibility, violation=0.1, penalty=0.0, score=0.0)


@pytest.fixture
def status(make_study):
    """Of a study with 5 trials."""
    return RunStatus(make_study(), METHODS["IV"])


class TestTimes:
    def test_nothing_is_known_at_first(self, status):
        status.begin(Phase.TUNING, 5)
        assert status.now == Snapshot(phase=Phase.TUNING, total=5)

    def test_share_of_the_optimizer(self, status, make_trial):
        status.begin(Phase.TUNING, 5)
        for k, proposal in enumerate((0.0, 4.0)):
            tell(status, timed(make_trial(k, {"gain": 0.5}, [1.0, 1.0]), proposal, evaluation=1.0))
        assert status.now.done == status.now.trials == 2
        # 4 s of proposals, 4 s of evaluations.
        assert status.now.overhead == 0.5

    def test_a_request_to_finish_ends_the_count(self, status, make_trial):
        status.begin(Phase.TUNING, 5)
        tell(status, make_trial(0, {"gain": 0.5}, [1.0, 1.0]))
        status.event(Event(Phase.TUNING, 1, EventKind.PAUSE))
        assert (status.now.total, status.now.finish) == (5, None)
        status.event(Event(Phase.TUNING, 2, EventKind.FINISH))
        assert (status.now.total, status.now.finish) == (2, 2)
        tell(status, make_trial(1, {"gain": 0.5}, [1.0, 1.0]))
        assert (status.now.done, status.now.total) == (2, 2)

    def test_time_left_in_each_phase(self, make_study, make_trial):
        now = 0.0
        status = RunStatus(make_study(), METHODS["IV"], lambda: now)
        status.begin(Phase.TUNING, 5)
        trial = timed(make_trial(0, {"gain": 0.5}, [1.0, 1.0]), 0.0, evaluation=1.0)
        for evaluation in trial.evaluations:
            now += 1.0
            status.evaluation(evaluation)
        status.trial(trial, None)
        # 4 trials of 2 evaluations, two checks of 20, and 2 x 5 of the validation.
        assert status.now.time_left == 58.0
        status.begin(Phase.CHECKING, 6)
        assert status.now.time_left == 50.0
        status.advance()
        assert status.now.done == 1
        status.begin(Phase.VALIDATION, 5)
        assert status.now.time_left == 10.0
        status.pause(True)
        now += 1000.0
        status.pause(False)
        assert status.now.time_left == 10.0

    def test_trials_on_record_count_as_if_just_run(self, make_study, make_trial):
        trials = [
            timed(make_trial(k, {"gain": 0.5}, [1.0, 1.0]), 3.0, evaluation=1.0) for k in range(3)
        ]
        one, other = (RunStatus(make_study(), METHODS["IV"], lambda: 0.0) for _ in range(2))
        for status in (one, other):
            status.begin(Phase.TUNING, 5)
        for trial in trials:
            tell(one, trial, candidate(trials[0]))
        other.recall(trials, candidate(trials[0]))
        assert one.now == other.now


def test_a_budget_of_evaluations_suffices_for_fewer_trials(make_study, make_trial):
    """12 evaluations for trials of 3 each, as many as there are of the latest ones."""
    study = make_study().replace(evaluations=12)
    status = RunStatus(study, METHODS["IV"])
    status.begin(Phase.TUNING, study.budget.trials)
    trials = [make_trial(k, {"gain": 0.5}, [1.0] * 3) for k in range(2)]
    status.recall(trials[:1], None)
    assert (status.now.done, status.now.total) == (1, 4)
    tell(status, trials[1])
    assert (status.now.done, status.now.total) == (2, 4)
    status.begin(Phase.VALIDATION, 5)
    assert status.now.total == 5


def test_counts_of_what_went_wrong(status, make_trial, failed):
    status.begin(Phase.TUNING, 5)
    tell(status, make_trial(0, {"gain": 0.5}, [1.0]))
    tell(status, make_trial(1, {"gain": 0.5}, [1.0], worst=2.0))
    lost = make_trial(2, {"gain": 0.5})
    evaluation = dataclasses.replace(
        lost.evaluations[0], outcome=failed("gone", EvaluationState.LOST)
    )
    tell(status, dataclasses.replace(lost, evaluations=(evaluation,), origin="space-filling"))
    now = status.now
    assert (now.failed, now.violating, now.lost, now.fallbacks) == (0, 1, 1, 1)
    tell(status, make_trial(3, {"gain": 0.5}))
    assert (status.now.failed, status.now.lost) == (1, 1)


def test_a_space_filling_trial_that_was_carried_over_counts_as_one(status, make_trial):
    origin = "space-filling (from runs/earlier, trial 7)"
    trial = dataclasses.replace(make_trial(0, {"gain": 0.5}, [1.0]), origin=origin)
    status.begin(Phase.TUNING, 5)
    status.recall([trial], None)
    assert status.now.fallbacks == 1


class TestDiagnostics:
    def test_names_and_levels(self, make_study, make_trial):
        study = make_study()
        within = make_trial(0, {"gain": 0.5}, [1.0])
        violating = make_trial(1, {"gain": 0.5}, [1.0], worst=2.0)
        stalled = make_trial(2, {"gain": 0.5})
        for trial, level, words in [
            (within, Level.OK, "within limits"),
            (violating, Level.WARN, "violates peak"),
            (stalled, Level.ERROR, "axis: stalled"),
        ]:
            result = trial_result(study, trial, None, "runs/a")
            assert (result.name, result.level) == ("tuner: trial_result", level)
            assert words in result.message
            found = safety(study, Snapshot(last=trial))
            assert (found.name, found.level) == ("tuner: safety", level)
            assert words in found.message

    def test_values_of_a_trial_read_back_to_the_last_bit(self, make_study, make_trial):
        study = make_study()
        trial = make_trial(3, {"gain": 1 / 3}, [0.1, 0.3], worst=2 / 3)
        values = trial_result(study, trial, candidate(trial), "runs/a").values
        assert float(values["parameters.gain"]) == 1 / 3
        assert float(values["metrics.error"]) == (0.1 + 0.3) / 2
        assert float(values["worst_case"]) == 2 / 3
        assert float(values["worst_context.load"]) == 1.5
        assert float(values["probability_feasible"]) == 0.9
        assert values["trial"] == values["incumbent"] == "3"
        assert values["evaluations"] == "2"
        assert values["bag"] == "runs/a/bags/trial_0003"

    def test_progress(self, make_study, make_trial):
        study = make_study()
        trial = make_trial(0, {"gain": 0.5}, [1.0])
        now = Snapshot(
            phase=Phase.TUNING,
            done=1,
            total=5,
            trials=1,
            incumbent=candidate(trial, feasibility=0.2),
            overhead=0.25,
            time_left=12.0,
            paused=True,
            advice=StopAdvice(1, 4, 0.01, 0.1),
        )
        found = progress(study, now)
        assert found.name == "tuner: progress"
        assert found.message == (
            "tuning: 1 of 5; advice: stop, the expected gain is below the noise; "
            "no feasible point yet; paused"
        )
        assert found.values["overhead"] == "0.25"
        assert found.values["time_left"] == "12.0"
        assert found.values["paused"] == found.values["stop_advised"] == "True"
        assert progress(study, Snapshot()).message == "starting"

    def test_what_others_make_of_trials_on_record_is_no_time_of_the_next(self, make_study):
        """As the advice to stop, which is computed anew for them."""
        now = [0.0]
        status = RunStatus(make_study(), METHODS["IV"], lambda: now[0])
        status.begin(Phase.TUNING, 5)
        status.recall([], None)
        now[0] = 1000.0
        status.restart()
        assert status._times._trial_began == 1000.0
        assert status.now.phase == Phase.TUNING

    def test_surrogate(self, make_study, make_trial):
        study = make_study()
        assert surrogate(study, Snapshot()).message == "no model yet"
        # One that cannot be fitted at all is trouble, too.
        unfitted = dataclasses.replace(make_trial(3, {"gain": 0.5}, [1.0]), warnings=("singular",))
        found = surrogate(study, Snapshot(last=unfitted))
        assert (found.level, found.message) == (Level.WARN, "singular")
        phi = Hyperparameters(length_scales=[0.25], signal=2.0, noise=0.125)
        trial = dataclasses.replace(
            make_trial(0, {"gain": 0.5}, [1.0]),
            hyperparameters={"objective": tuple(phi.to_log().tolist())},
            origin="acquisition",
        )
        found = surrogate(study, Snapshot(last=trial))
        assert found.message == "trial 0: acquisition"
        assert float(found.values["objective.length_scale.gain"]) == pytest.approx(0.25)
        assert float(found.values["objective.noise"]) == pytest.approx(0.125)
        warned = dataclasses.replace(trial, warnings=("objective: noise at its bound",))
        assert surrogate(study, Snapshot(last=warned)).level is Level.WARN
