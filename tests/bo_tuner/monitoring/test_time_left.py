"""The time left, by a clock of our own that only the steps of a run advance."""

import dataclasses

import numpy as np
import pytest

from bo_tuner.methods.registry import METHODS
from bo_tuner.monitoring.time_left import SPARE, TimeLeft
from bo_tuner.plans import Phase


class Machine:
    """Takes the time of evaluations, proposals and rankings, and tells of them."""

    def __init__(self, study, algorithm, make_trial, workers=1):
        self.now = 0.0
        self.left = TimeLeft(study, METHODS[algorithm], lambda: self.now, workers)
        self._make_trial = make_trial
        self._number = 0

    def trial(self, evaluations=2, *, proposal=0.0, evaluation=1.0, ranking=0.0, warm_up=0.0):
        trial = self._make_trial(self._number, {"gain": 0.5}, [1.0] * evaluations)
        self._number += 1
        self.now += proposal
        done = [dataclasses.replace(item, seconds=evaluation) for item in trial.evaluations]
        if warm_up:
            warmed = done[0].outcome.noted(warm_ups=3, warm_up_seconds=warm_up)
            done[0] = dataclasses.replace(done[0], outcome=warmed)
            self.now += warm_up
        for item in done:
            self.now += evaluation
            self.left.evaluation(item)
        self.now += ranking
        trial = dataclasses.replace(trial, evaluations=tuple(done), seconds=proposal)
        self.left.trial(trial)
        return trial

    def evaluations(self, count, evaluation=1.0, *, ranking=0.0, recorded=False):
        """Evaluations of another phase than the tuning; those on record take no time."""
        for item in self._make_trial(0, {"gain": 0.5}, [1.0] * count).evaluations:
            self.now += 0.0 if recorded else ranking + evaluation
            self.left.evaluation(dataclasses.replace(item, seconds=evaluation, recorded=recorded))


@pytest.fixture
def machine(make_study, make_trial):
    """Function for a machine; of a study with 5 trials unless the budget is changed."""

    def make(algorithm, workers=1, **budget):
        study = make_study()
        study = study.replace(**budget) if budget else study
        return Machine(study, algorithm, make_trial, workers)

    return make


def test_all_that_is_to_come_counts(machine):
    run = machine("IV")
    run.left.begin(Phase.TUNING)
    assert run.left.estimate() is None
    run.trial()
    # 4 trials of 2 evaluations; 2 checks of 20 evaluations, and 2 x 5 of the validation, 1 s each.
    assert run.left.estimate() == 4 * 2.0 + 40.0 + 10.0
    run.left.begin(Phase.CHECKING)
    assert run.left.estimate() == 40.0 + 10.0
    run.evaluations(24)
    assert run.left.estimate() == 16.0 + 10.0
    run.left.begin(Phase.VALIDATION)
    run.evaluations(4)
    assert run.left.estimate() == 6.0


def test_what_a_run_takes_that_is_asked_to_finish(machine):
    """One more trial, and the answer; then one more run, and the validation; then only that."""
    run = machine("IV")
    run.left.begin(Phase.TUNING)
    assert run.left.to_finish() is None
    run.trial()
    assert run.left.to_finish() == pytest.approx(SPARE * (2.0 + 40.0 + 10.0))
    run.left.begin(Phase.CHECKING)
    run.evaluations(3, 2.0)
    assert run.left.to_finish() == pytest.approx(SPARE * (2.0 + 10.0))
    run.left.begin(Phase.VALIDATION)
    run.evaluations(4)
    assert run.left.to_finish() == pytest.approx(SPARE * 6.0)


@pytest.mark.parametrize("workers", [1, 3])
def test_a_certificate_follows(machine, workers):
    run = machine("IV", workers)
    run.left.begin(Phase.TUNING)
    run.left.expect_certificate(30)
    assert run.left.of_certificate() == 0.0
    assert run.left.of_trial() is None
    run.trial(evaluation=2.0, proposal=4.0)
    result = run.left.to_finish()
    without = machine("IV", workers)
    without.left.begin(Phase.TUNING)
    without.trial(evaluation=2.0, proposal=4.0)
    # 30 evaluations of 2 s.
    assert run.left.of_certificate() == pytest.approx(60.0 / workers)
    assert run.left.estimate() == pytest.approx(without.left.estimate() + 60.0 / workers)
    # The result itself comes as soon.
    assert result == without.left.to_finish()
    assert run.left.of_trial() == 2 * 2.0 + 4.0


def test_the_record_of_each_evaluation_takes_its_time_as_well(machine):
    """Of that beside evaluations the least is the record, the rest proposals and models."""
    run = machine("IV")
    run.left.begin(Phase.CHECKING)
    run.trial()
    run.left.begin(Phase.CHECKING)
    for beside in [0.5] * 5 + [3.0] * 5:
        run.evaluations(1, ranking=beside)
    # 30 of 40 evaluations that take 2.75 s each by the latest ten; 10 of the validation.
    assert run.left.estimate() == pytest.approx(30 * 2.75 + 10 * (1.0 + 0.5))


def test_workers_share_the_validation(machine):
    run = machine("IV", workers=4)
    run.left.begin(Phase.TUNING)
    run.trial()
    assert run.left.estimate() == 4 * 2.0 + 40.0 + 10.0 / 4


def test_a_second_candidate_that_fails_its_check_has_another_one_follow(machine):
    run = machine("IV")
    run.left.begin(Phase.TUNING)
    run.trial()
    run.left.begin(Phase.CHECKING)
    run.evaluations(42)
    assert run.left.estimate() == 18.0 + 10.0


def test_an_evaluation_takes_its_part_of_proposals_and_rankings(machine):
    run = machine("boundary", trials=3, initial_trials=1)
    run.left.begin(Phase.TUNING)
    run.trial(4)
    run.trial(4, proposal=3.0, ranking=1.0)
    # 12 s for two trials of 4 evaluations. One more trial and 20 repetitions follow; no proposals
    # stand between the 10 evaluations of the validation.
    assert run.left.estimate() == pytest.approx(6.0 + 1.5 * 20 + 10.0)
    run.left.begin(Phase.CHECKING)
    run.evaluations(5, ranking=4.0)
    assert run.left.estimate() == pytest.approx(5.0 * 15 + 10.0)


def test_a_large_run_is_settled_after_25_repetitions(machine):
    run = machine("boundary", trials=3)
    run.left.begin(Phase.TUNING)
    for _ in range(3):
        run.trial(100)
    assert run.left.estimate() == pytest.approx(25.0 + 10.0)


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


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("evaluation", [0.001, 0.02, 1.0])
@pytest.mark.parametrize("algorithm", ["IV", "boundary"])
def test_it_is_right_within_a_factor_of_two_in_the_middle(machine, algorithm, evaluation, seed):
    """After 19 to 23 of 40 trials; rankings grow with the evaluations so far."""
    rng = np.random.default_rng(seed)
    pooled = algorithm == "boundary"
    run = machine(algorithm, trials=40, initial_trials=8, validation_draws=25)
    run.left.begin(Phase.TUNING)
    known, announced = 0, []
    for k in range(40):
        count = 3 if pooled and k >= 20 else int(rng.integers(4, 8))
        known += count
        ranking = (0.002 if pooled else 0.0005) * known * rng.uniform(0.9, 1.1)
        proposal = 0.0 if k < 8 else 4.0 * ranking
        run.trial(count, proposal=proposal, evaluation=evaluation, ranking=ranking)
        announced.append((run.now, run.left.estimate()))
    run.left.begin(Phase.CHECKING)
    # The repetitions are used up; of the candidates the second passes its check.
    run.evaluations(25 if pooled else 40, evaluation, ranking=0.002 * known if pooled else 0.0)
    run.left.begin(Phase.VALIDATION)
    run.evaluations(50, evaluation)
    ratios = [left / (run.now - at) for at, left in announced[18:23]]
    assert min(ratios) > 0.5
    assert max(ratios) < 2.0


def test_it_follows_a_change_of_the_load_after_ten_trials(machine):
    run = machine("IV", trials=40)
    run.left.begin(Phase.TUNING)
    for _ in range(10):
        run.trial()
    for _ in range(10):
        run.trial(evaluation=4.0)
    assert run.left.estimate() == 4.0 * (20 * 2 + 40 + 10)


def test_what_a_phase_takes_shows_in_it(machine):
    run = machine("IV")
    run.left.begin(Phase.TUNING)
    run.trial()
    run.left.begin(Phase.VALIDATION)
    run.evaluations(5, evaluation=7.0)
    assert run.left.estimate() == 5 * 7.0


def test_the_warm_up_is_no_time_of_what_is_to_come(machine):
    cold, warm = machine("IV"), machine("IV")
    for run, seconds in ((cold, 100.0), (warm, 0.0)):
        run.left.begin(Phase.TUNING)
        run.trial(warm_up=seconds)
        run.trial()
    assert cold.now == warm.now + 100.0
    assert cold.left.estimate() == warm.left.estimate()


@pytest.mark.parametrize("phase", [Phase.TUNING, Phase.CHECKING, Phase.VALIDATION])
def test_a_pause_is_no_time_of_the_run(machine, phase):
    runs = [machine("IV"), machine("IV")]
    for run in runs:
        run.left.begin(Phase.TUNING)
        run.trial()
        run.left.begin(phase)
        if run is runs[1]:
            before = run.left.estimate()
            run.left.pause()
            assert run.left.estimate() == before
            run.now += 1000.0
            run.left.pause()
        if phase == Phase.TUNING:
            run.trial(proposal=4.0, ranking=1.0)
        else:
            run.evaluations(3, evaluation=7.0)
    assert runs[0].left.estimate() == runs[1].left.estimate()


@pytest.mark.parametrize("algorithm", ["IV", "boundary"])
def test_trials_on_record_count_as_if_just_run(machine, algorithm):
    one, other = machine(algorithm), machine(algorithm)
    for run in (one, other):
        run.left.begin(Phase.TUNING)
    other.left.recall([one.trial(proposal=p) for p in (0.0, 4.0, 5.0)])
    assert other.left.estimate() == pytest.approx(one.left.estimate())


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


def test_a_run_that_is_to_finish_has_no_further_trials(machine):
    """One trial of 2 s is under way when somebody asks for the end."""
    run = machine("IV")
    run.left.begin(Phase.TUNING)
    run.trial()
    run.left.finish(2)
    # The trial; 2 checks of 20 evaluations, and 2 x 5 of the validation, 1 s each.
    assert run.left.estimate() == 2.0 + 40.0 + 10.0
    run.trial()
    assert run.left.estimate() == 40.0 + 10.0
