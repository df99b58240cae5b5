"""Deaths that are ignored: how likely they are at most, and whether they depend on anything."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import beta

from bo_tuner.evidence.certificate.deaths import deaths_in
from bo_tuner.evidence.verdict import State, Verdict
from bo_tuner.evidence.words.certificate import of_deaths
from bo_tuner.evidence.words.verdict import headline, mark_in_words
from bo_tuner.run_notes import Notes
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage

TUNED, OTHER = {"gain": 0.25}, {"gain": 0.5}
CONFIDENCE = 0.95


@pytest.fixture
def study(make_study):
    """One whose simulator may die."""
    return make_study(nodes={"axis": {"node": "axis", "result": "~/r", "death": "ignore"}})


def runs(parameters, deaths, loads=None):
    """Runs that came to an end after some deaths each."""
    loads = np.full(len(deaths), 1.0) if loads is None else loads
    return [
        Evaluation(
            0,
            k,
            Stage.VALIDATION,
            parameters,
            {"load": float(load)},
            k,
            Outcome(
                EvaluationState.COMPLETE, {"error": 1.0, "peak": 0.5}, notes=Notes(deaths=count)
            ),
        )
        for k, (count, load) in enumerate(zip(deaths, loads, strict=True))
    ]


def test_without_a_node_whose_death_is_ignored_there_is_nothing_to_say(make_study):
    assert deaths_in(make_study(), runs(TUNED, [0, 0]), [], CONFIDENCE) is None


def test_the_bound_is_valid_and_no_wonder(study):
    """It holds after every run, so it is above that of Clopper and Pearson, which does not."""
    found = deaths_in(study, runs(TUNED, [0, 1, 0, 0, 2, *[0] * 95]), [], CONFIDENCE)
    assert (found.deaths, found.runs) == (3, 103)
    single = beta.ppf(CONFIDENCE, 4, 100)
    assert single < found.bound < 2.0 * single
    assert found.depend_on == ()


def test_the_bound_covers_the_probability(study):
    """In 400 series of 30 runs that ended, each with a geometric number of deaths."""
    rng, probability = np.random.default_rng(3), 0.1
    below = sum(
        deaths_in(study, runs(TUNED, rng.geometric(1.0 - probability, 30) - 1), [], 0.9).bound
        < probability
        for _ in range(400)
    )
    # More than 65 of 400 have a probability of 1e-4 if it is 0.1 each.
    assert below <= 65


def test_independent_deaths_are_hardly_ever_said_to_depend_on_anything(study):
    rng = np.random.default_rng(4)
    named = 0
    for _ in range(200):
        mine, others = (rng.geometric(0.9, 40) - 1 for _ in range(2))
        of_set = runs(TUNED, mine, rng.uniform(0.0, 2.0, 40))
        of_others = runs(OTHER, others, rng.uniform(0.0, 2.0, 40))
        named += bool(deaths_in(study, of_set, of_others, CONFIDENCE).depend_on)
    # More than 9 of 200 have a probability below 1e-4 if it is 0.01 each.
    assert named <= 9


def test_deaths_of_the_set_are_found(study):
    found = deaths_in(study, runs(TUNED, [1] * 15 + [0] * 15), runs(OTHER, [0] * 60), CONFIDENCE)
    assert found.depend_on == ("parameters",)


def test_deaths_in_a_context_are_found(study):
    loads = np.linspace(0.0, 2.0, 40)
    found = deaths_in(study, runs(TUNED, (loads > 1.5).astype(int), loads), [], CONFIDENCE)
    assert found.depend_on == ("load",)
    first, second = of_deaths(found, CONFIDENCE)
    assert first.startswith("a node died in 10 of 50 runs, which were made again; ")
    assert second.startswith("deaths depend on load: ")


def test_a_pass_says_of_which_runs_it_is():
    verdict = Verdict(state=State.CERTIFIED, trial=0)
    assert "of runs that ended" not in headline(verdict)
    of_ended = replace(verdict, of_ended=True)
    assert mark_in_words(of_ended) == "PASS of runs that ended"
    assert headline(of_ended).startswith("PASS of runs that ended: ")
