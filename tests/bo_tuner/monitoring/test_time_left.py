"""The time left, by a clock of our own that only the steps of a run advance."""

import dataclasses
import math

import numpy as np
import pytest

from bo_tuner.methods.registry import METHODS
from bo_tuner.monitoring.time_left import TimeLeft
from bo_tuner.plans import Phase
from bo_tuner.trials import Stage


class Machine:
    """Takes the time of evaluations, proposals and rankings, and tells of them."""

    def __init__(self, study, algorithm, make_trial):
        self.now = 0.0
        self.slowdown = 1.0
        self.left = TimeLeft(study, METHODS[algorithm], lambda: self.now)
        self._make_trial = make_trial
        self._number = 0
        self.known = 0

    def pass_time(self, seconds):
        self.now += self.slowdown * seconds

    def trial(self, evaluations=2, *, proposal=0.0, evaluation=1.0, ranking=0.0, search=0.0):
        """A trial; half of its evaluations are of a search, each after a decision."""
        trial = self._make_trial(self._number, {"gain": 0.5}, [1.0] * evaluations)
        self._number += 1
        self.pass_time(proposal)
        done = []
        for item in trial.evaluations:
            searched = 2 * item.index >= evaluations > 2
            self.pass_time(evaluation + (search if searched else 0.0))
            stage = Stage.SEARCH if searched else item.stage
            seconds = self.slowdown * evaluation
            done.append(dataclasses.replace(item, stage=stage, seconds=seconds))
            self.left.evaluation(done[-1])
        self.pass_time(ranking)
        trial = dataclasses.replace(
            trial,
            evaluations=tuple(done),
            seconds=self.slowdown * proposal,
            origin="acquisition" if proposal else "initial",
        )
        self.left.trial(trial)
        return trial

    def evaluations(self, count, evaluation=1.0, *, recorded=False):
        """Evaluations of another phase than the tuning; those on record take no time."""
        for item in self._make_trial(0, {"gain": 0.5}, [1.0] * count).evaluations:
            self.pass_time(0.0 if recorded else evaluation)
            seconds = self.slowdown * evaluation
            self.left.evaluation(dataclasses.replace(item, seconds=seconds, recorded=recorded))


@pytest.fixture
def machine(make_study, make_trial):
    """Function for a machine; of a study with 5 trials unless the budget is changed."""

    def make(algorithm, **budget):
        study = make_study()
        return Machine(study.replace(**budget) if budget else study, algorithm, make_trial)

    return make


def test_all_that_is_to_come_counts(machine):
    run = machine("IV")
    run.left.begin(Phase.TUNING)
    assert run.left.estimate() is None
    run.trial()
    # 4 trials of 2 evaluations; 2 checks of 20 evaluations, and 2 x 5 of the validation, 1 s each.
    assert run.left.estimate() == 4 * 2.0 + 40.0 + 10.0
    run.trial(proposal=4.0)
    assert run.left.estimate() == 3 * (4.0 + 2.0) + 40.0 + 10.0
    run.left.begin(Phase.CHECKING)
    assert run.left.estimate() == 40.0 + 10.0
    run.evaluations(24)
    assert run.left.estimate() == 16.0 + 10.0
    # One has not passed: as many are to come as after the first one.
    run.left.step()
    assert run.left.estimate() == 36.0 + 10.0
    run.left.begin(Phase.VALIDATION)
    run.evaluations(4)
    assert run.left.estimate() == 6.0


def test_without_a_check_there_is_none_to_wait_for(machine):
    run = machine("I")
    run.left.begin(Phase.TUNING)
    run.trial()
    assert run.left.estimate() == 4 * 2.0 + 10.0


def test_a_budget_of_evaluations_ends_the_trials_sooner(machine):
    run = machine("I", evaluations=6)
    run.left.begin(Phase.TUNING)
    run.trial()
    # 4 evaluations are left of the budget, which are 2 of the 4 trials.
    assert run.left.estimate() == 2 * 2.0 + 10.0


def pooled_trials(run, count, evaluations, *, per_evaluation, fixed=0.0, ratio=5.0):
    """Trials of pooled models: a ranking takes a time that grows with all evaluations so far.

    What a trial takes beside its evaluations is `ratio` rankings.
    """
    for _ in range(count):
        run.known += evaluations
        ranking = fixed + per_evaluation * run.known
        run.trial(evaluations, proposal=(ratio - 1.0) * ranking, ranking=ranking)


def test_rankings_count_between_repetitions(machine):
    run = machine("boundary")
    run.left.begin(Phase.TUNING)
    pooled_trials(run, 5, 2, per_evaluation=0.3)
    # 20 repetitions after 10 evaluations, with a ranking before the first and after each, of as
    # many as are made in the middle; and 10 evaluations of the validation.
    rankings = 21 * 0.3 * (10 + 10)
    assert run.left.estimate() == pytest.approx(20.0 + rankings + 10.0)
    run.left.begin(Phase.CHECKING)
    assert run.left.estimate() == pytest.approx(20.0 + rankings + 10.0)
    run.evaluations(4)
    rankings = 17 * 0.3 * (10 + 12)
    assert run.left.estimate() == pytest.approx(16.0 + rankings + 10.0)


def test_a_large_run_is_settled_after_25_repetitions(machine):
    run = machine("boundary", trials=3)
    run.left.begin(Phase.TUNING)
    pooled_trials(run, 3, 100, per_evaluation=0.0)
    assert run.left.estimate() == pytest.approx(25.0 + 10.0)


def test_points_at_the_boundary_take_fewer_evaluations(machine):
    run = machine("boundary", trials=12)
    run.left.begin(Phase.TUNING)
    pooled_trials(run, 5, 6, per_evaluation=0.1, fixed=2.0)
    # One more of the search; six with a run in a drawn context and two in the worst one. Each has
    # five rankings beside them, by all evaluations so far.
    known = np.cumsum([30, 6, *6 * [3]])
    trials = 1 * 6 + 6 * 3 + 5 * sum(2.0 + 0.1 * known[1:])
    rankings = 21 * (2.0 + 0.1 * (known[-1] + 10))
    assert run.left.estimate() == pytest.approx(trials + 20.0 + rankings + 10.0)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("evaluation", [0.001, 0.02, 1.0])
@pytest.mark.parametrize("ratio", [4.0, 6.0])
def test_a_run_of_pooled_models_is_right_to_a_fifth_from_a_third_on(
    machine, ratio, evaluation, seed
):
    """Where the repetitions are used up, all of them for runs of their own of some candidates."""
    rng = np.random.default_rng(seed)
    run = machine("boundary", trials=40, initial_trials=8, validation_draws=25)
    run.left.begin(Phase.TUNING)
    known, told = 0, []
    for k in range(40):
        count = int(rng.integers(3, 8)) if k < 20 else 3
        known += count
        ranking = 0.002 * known * rng.uniform(0.9, 1.1)
        proposal = 0.0 if k < 8 else (ratio - 1.0) * ranking
        run.trial(count, proposal=proposal, evaluation=evaluation, ranking=ranking)
        told.append((k + 1, run.now, run.left.estimate()))
    run.left.begin(Phase.CHECKING)
    repetitions = math.ceil(known / 6)
    for k in range(repetitions):
        run.pass_time(0.002 * (known + k))
        run.evaluations(1, evaluation=evaluation)
    run.pass_time(0.002 * (known + repetitions))
    run.left.begin(Phase.VALIDATION)
    run.evaluations(50, evaluation=evaluation)
    for done, at, left in told:
        if 3 * done >= 40:
            assert left == pytest.approx(run.now - at, rel=0.2), done


def test_what_a_phase_takes_shows_in_it(machine):
    run = machine("IV")
    run.left.begin(Phase.TUNING)
    for _ in range(5):
        run.trial()
    run.left.begin(Phase.VALIDATION)
    run.evaluations(5, evaluation=7.0)
    # 5 to come; ten of 1 s were expected, five of 7 s are known.
    assert run.left.estimate() == pytest.approx(5 * (10 * 1.0 + 5 * 7.0) / 15)


def test_a_pause_is_no_time_of_the_run(machine):
    runs = [machine("IV"), machine("IV")]
    for run in runs:
        run.left.begin(Phase.TUNING)
        run.trial()
        if run is runs[1]:
            run.left.pause()
            run.now += 1000.0
            run.left.pause()
        run.trial(proposal=4.0, ranking=1.0)
    assert runs[0].left.estimate() == runs[1].left.estimate()


@pytest.mark.parametrize("phase", [Phase.CHECKING, Phase.VALIDATION])
def test_the_time_left_is_the_same_during_a_pause(machine, phase):
    """Also where most of what is known of an evaluation was measured in the phase."""
    run = machine("IV", validation_draws=20)
    run.left.begin(Phase.TUNING)
    run.trial()
    run.left.begin(phase)
    run.evaluations(15, evaluation=7.0)
    before = run.left.estimate()
    run.left.pause()
    assert run.left.estimate() == before
    run.now += 1000.0
    run.left.pause()
    assert run.left.estimate() == before


@pytest.mark.parametrize(("algorithm", "part"), [("IV", 0.0), ("boundary", 0.25)])
def test_trials_on_record_count_as_if_just_run(machine, algorithm, part):
    """Of pooled models, a proposal takes four rankings."""
    one, other = machine(algorithm), machine(algorithm)
    for run in (one, other):
        run.left.begin(Phase.TUNING)
    trials = [one.trial(proposal=p, ranking=part * p) for p in (0.0, 4.0, 5.0)]
    other.left.recall(trials)
    assert other.left.estimate() == pytest.approx(one.left.estimate())


def whole_run(run, trials, growth, rng, *, checks, change=None, slowdown=1.0):
    """What was announced after each trial, with the time since, and the end."""
    initial, told = trials // 6, []
    run.left.begin(Phase.TUNING)
    for k in range(trials):
        if k == change:
            run.slowdown = slowdown
        proposal = 0.0 if k < initial else 1.0 + growth * (k - initial)
        evaluations = int(rng.integers(4, 9))
        run.trial(evaluations, proposal=proposal, evaluation=0.5, ranking=0.3, search=0.1)
        told.append((k + 1, run.now, run.left.estimate()))
    run.left.begin(Phase.CHECKING)
    for _ in range(checks):
        run.evaluations(20, evaluation=0.5)
        run.pass_time(0.3)
        run.left.step()
    told.append((trials, run.now, None))
    run.left.begin(Phase.VALIDATION)
    run.evaluations(60, evaluation=0.5)
    return told[:-1], run.now


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("growth", [0.0, 0.05, 0.2])
@pytest.mark.parametrize("trials", [30, 90])
def test_it_is_right_to_a_fifth_from_a_third_on(machine, trials, growth, seed):
    """Where as many candidates are checked as expected."""
    run = machine("IV", trials=trials, initial_trials=trials // 6, validation_draws=30)
    told, end = whole_run(run, trials, growth, np.random.default_rng(seed), checks=2)
    for done, at, left in told:
        if 3 * done >= trials:
            assert left == pytest.approx(end - at, rel=0.2), done


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("slowdown", [0.4, 2.5])
def test_it_follows_a_change_of_the_load(machine, slowdown, seed):
    """Ten trials after the change, at an eighth of the run."""
    run = machine("IV", trials=80, initial_trials=13, validation_draws=30)
    rng = np.random.default_rng(seed)
    told, end = whole_run(run, 80, 0.0, rng, checks=2, change=10, slowdown=slowdown)
    for done, at, left in told:
        if done >= 27:
            assert left == pytest.approx(end - at, rel=0.2), done


def test_evaluations_on_record_do_not_shorten_those_to_come(machine):
    """Of 10 draws of the validation 8 were made before the run was interrupted."""
    run = machine("IV")
    run.left.begin(Phase.TUNING)
    run.trial()
    run.left.begin(Phase.VALIDATION)
    run.evaluations(8, recorded=True)
    assert run.left.estimate() == 2.0
    run.evaluations(1)
    assert run.left.estimate() == 1.0


def test_a_design_that_was_carried_over_counts_as_one(machine):
    """As the same trials do that the run has made itself."""
    one, other = machine("IV"), machine("IV")
    for run in (one, other):
        run.left.begin(Phase.TUNING)
    trials = [one.trial(count, proposal=p) for count, p in ((8, 0.0), (2, 4.0))]
    other.left.recall(
        [
            dataclasses.replace(t, origin=f"{t.origin} (from runs/earlier, trial {t.number})")
            for t in trials
        ]
    )
    assert other.left.estimate() == pytest.approx(one.left.estimate())
