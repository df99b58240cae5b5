"""Why nothing is feasible: facts of trials made by hand, and what a screen says of facts."""

from dataclasses import replace

import pytest

from bo_tuner.evidence.at_bounds import at_bound
from bo_tuner.evidence.infeasible import (
    Blocker,
    Infeasible,
    LimitReached,
    Loosened,
    Nearest,
    Reached,
    infeasible,
)
from bo_tuner.evidence.verdict import State, Verdict
from bo_tuner.evidence.words.infeasible import advice_in_words, blocker_in_words, reasons_in_words
from bo_tuner.evidence.words.next_steps import next_steps
from bo_tuner.evidence.words.verdict import as_mapping, notes_of_file
from bo_tuner.study.limit_kinds.chance import Chance
from bo_tuner.trials import EvaluationState, Outcome, TrialState, WorstCase
from bo_tuner.tuning.prospects import Beyond, Prospects

MEANS = {
    name: {"kind": "worst_case", "metric": metric, "upper": 1.0}
    for name, metric in (("peak", "peak"), ("slow", "error"))
}


@pytest.fixture
def facts(make_study, make_trial):
    """Function that returns the facts on trials: each its worst peak and error, or no values."""

    def facts(*pairs, constraints=MEANS, **more):
        trials = []
        for number, pair in enumerate(pairs):
            trial = make_trial(number, {"gain": 0.1 * number}, [1.0] if pair else [])
            if pair:
                found = {
                    name: WorstCase(value, {"load": 2.0}, value)
                    for name, value in zip(constraints, pair, strict=True)
                }
                trial = replace(trial, worst_cases=found)
            trials.append(trial)
        return infeasible(make_study(constraints=constraints), trials, **more)

    return facts


class TestFacts:
    def test_one_limit_blocks(self, facts):
        """It is loosened to the best of the trials that keep the other one, not to the best."""
        found = facts((1.2, 3.0), (1.5, 0.5), (1.8, 0.4))
        assert (found.blocker, found.blocking) == (Blocker.LIMITS, ("peak",))
        peak, slow = found.limits
        assert (peak.broke, peak.trials, slow.broke) == (3, 3, 1)
        assert (peak.best, peak.beside) == (Reached(0, 1.2), Reached(1, 1.5))
        assert found.loosened == ((Loosened("peak", 1.5),),)

    def test_two_in_conflict(self, facts):
        """Trials keep each, but none keeps both: either may be loosened, the nearer one first."""
        found = facts((0.5, 4.0), (2.0, 0.5), (0.6, 3.0))
        assert (found.blocker, found.blocking) == (Blocker.CONFLICT, ("peak", "slow"))
        assert found.loosened == ((Loosened("peak", 2.0),), (Loosened("slow", 3.0),))

    def test_a_little_of_both_comes_before_much_of_one(self, facts):
        found = facts((0.5, 4.0), (2.0, 0.5), (1.1, 1.2))
        assert found.blocker is Blocker.CONFLICT
        assert found.loosened == (
            (Loosened("peak", 1.1), Loosened("slow", 1.2)),
            (Loosened("peak", 2.0),),
        )

    def test_two_that_no_trial_keeps_are_loosened_together(self, facts):
        found = facts((1.2, 3.0), (1.5, 1.6), (9.0, 1.1))
        assert (found.blocker, found.blocking) == (Blocker.LIMITS, ("peak", "slow"))
        assert found.loosened == ((Loosened("peak", 1.5), Loosened("slow", 1.6)),)

    def test_a_limit_of_zero_is_as_large_as_the_values_beside_it(self, facts):
        """In units a thousand times as large the same trial is the nearest."""
        for unit in (1.0, 1000.0):
            limits = {**MEANS, "peak": MEANS["peak"] | {"upper": 0.0}}
            found = facts((0.2 * unit, 1.5), (1.0 * unit, 1.1), constraints=limits)
            assert (found.nearest.trial, found.nearest.limit) == (0, "slow")
            assert found.nearest.excess == pytest.approx(0.5)

    def test_the_nearest_is_so_to_all_limits_at_once(self, facts):
        """Trial 0 is the nearest to one limit, and 300 % beyond the other."""
        assert facts((1.01, 4.0), (1.5, 2.0)).nearest == Nearest(1, "slow", 2.0, 1.0)

    def test_of_a_lower_limit(self, facts):
        limits = {"peak": {"kind": "worst_case", "metric": "peak", "lower": 4.0}}
        found = facts((2.0,), (3.0,), constraints=limits)
        assert found.nearest == Nearest(1, "peak", 3.0, 0.25)
        assert found.loosened == ((Loosened("peak", 3.0),),)

    def test_deaths(self, facts):
        found = facts((), (), (0.5, 2.0))
        assert (found.blocker, found.trials, found.died) == (Blocker.DEATHS, 3, 2)
        assert found.death == "axis: stalled"
        assert facts((), ()).nearest is None

    def test_deaths_of_few_are_counted_but_do_not_block(self, facts):
        found = facts((), (0.5, 2.0), (0.5, 3.0))
        assert (found.blocker, found.died, found.limits[1].trials) == (Blocker.LIMITS, 1, 2)

    def test_a_trial_that_kept_all_limits_leaves_the_margin(self, facts):
        found = facts((0.5, 0.9), (0.5, 2.0), refuted=["slow"])
        assert (found.blocker, found.blocking) == (Blocker.MARGIN, ("slow",))
        assert found.loosened == ()

    def test_a_trial_that_was_cut_short_broke_what_it_had_reached(self, make_study, make_trial):
        trial = make_trial(0, {"gain": 0.5})
        cut = Outcome.cut_short(0.5, {"peak": 3.0}, "peak is beyond its limit")
        (evaluation,) = trial.evaluations
        trial = replace(
            trial, state=TrialState.CUT_SHORT, evaluations=(replace(evaluation, outcome=cut),)
        )
        found = infeasible(make_study(constraints=MEANS), [trial])
        peak, slow = found.limits
        assert (found.died, peak.broke, peak.trials, peak.best) == (0, 1, 1, None)
        assert (slow.broke, slow.trials) == (0, 0)

    def test_a_lost_trial_says_nothing(self, make_study, make_trial):
        trial = make_trial(0, {"gain": 0.5})
        lost = Outcome(EvaluationState.LOST, {}, "gone")
        trial = replace(trial, evaluations=(replace(trial.evaluations[0], outcome=lost),))
        assert infeasible(make_study(), [trial]).trials == 0

    def test_of_a_share_of_runs_the_value_counts_that_as_many_must_keep(
        self, make_study, make_trial
    ):
        """Of ten runs nine must keep the limit, so it is the ninth that decides."""
        limit = {"often": {"kind": "chance", "metric": "error", "upper": 1.0, "probability": 0.9}}
        trial = make_trial(0, {"gain": 0.5}, [float(k) for k in range(20, 10, -1)])
        (often,) = infeasible(make_study(constraints=limit), [trial]).limits
        assert often.best == Reached(0, 19.0)

    def test_of_a_mean_the_mean_counts(self, make_study, make_trial, monkeypatch):
        monkeypatch.setattr(Chance, "on_runs", False)
        limit = {"often": {"kind": "chance", "metric": "error", "upper": 1.0, "probability": 0.9}}
        trial = make_trial(0, {"gain": 0.5}, [1.0, 2.0, 6.0])
        (often,) = infeasible(make_study(constraints=limit), [trial]).limits
        assert often.best == Reached(0, 3.0)

    def test_a_bound_that_cannot_be_moved_is_not_proposed(self, facts):
        """The gain of the study is within 0 and 1; below 0 its sign would change."""
        beyond = (Beyond("gain", "lower", 0.9), Beyond("gain", "upper", 0.8))
        (bound,) = facts((1.5, 2.0), prospects=Prospects(0.01, beyond)).beyond
        assert (bound.side, bound.wider) == ("upper", (0, 2))


def by_hand(study):
    """Facts as no trial has made them."""
    return Infeasible(
        trials=20,
        died=3,
        death="axis: stalled",
        limits=(
            LimitReached(
                "real_time", "solve time", "ms", 2.0, True, 17, 17, Reached(4, 2.0123),
                Reached(9, 2.3071),
            ),
            LimitReached(
                "distance", "lowest distance", "m", 0.5, False, 5, 17, Reached(2, 0.9), None
            ),
        ),
        blocker=Blocker.LIMITS,
        blocking=("real_time",),
        nearest=Nearest(9, "real_time", 2.3071, 0.15355),
        loosened=((Loosened("real_time", 2.3071),),),
        chance=0.12,
        beyond=(at_bound(study.parameters["gain"], "upper"),),
    )  # fmt: skip


class TestWords:
    def test_the_screen(self, make_study):
        facts = by_hand(make_study())
        assert [*reasons_in_words(facts), *advice_in_words(facts)] == [
            "3 of 20 trials failed: axis: stalled.",
            "solve time: 17 of 17 trials over the limit 2 ms; the best has 2.012 ms (trial 4), of "
            "those within all other limits 2.307 ms (trial 9).",
            "lowest distance: 5 of 17 trials over the limit 0.5 m; the best has 0.9 m (trial 2).",
            "Nearest to all limits in its own runs: trial 9, whose solve time is farthest over "
            "(2.307 ms, limit 2 ms).",
            "Run more trials: by the models, the best parameter set within the bounds is 12 % "
            "likely to keep all limits.",
            "Loosen the limit of solve time to at least 2.31 ms.",
            "The models expect feasible parameter sets beyond the upper bound of gain: widen that "
            "range.",
        ]

    def test_where_more_trials_promise_little_the_limit_comes_first(self, make_study):
        facts = replace(by_hand(make_study()), chance=0.001, beyond=())
        first, second = advice_in_words(facts)
        assert (first[:7], second[:11]) == ("Loosen ", "More trials")

    def test_a_conflict(self, make_study):
        facts = replace(
            by_hand(make_study()),
            blocker=Blocker.CONFLICT,
            blocking=("real_time", "distance"),
            loosened=(
                (Loosened("real_time", 2.0123), Loosened("distance", 0.1239)),
                (Loosened("real_time", 2.3071),),
            ),
        )
        said = blocker_in_words(facts)
        assert said.startswith("the limits of solve time and lowest distance are in conflict: ")
        # Rounded so that the limit is not tighter than the value.
        assert (
            "Loosen the limit of solve time to at least 2.02 ms and the limit of lowest distance "
            "to at most 0.123 m, or the limit of solve time to at least 2.31 ms."
        ) in advice_in_words(facts)

    @pytest.mark.parametrize(
        ("excess", "advice"),
        [
            (-0.01, "Loosen the limit of solve time, which leaves the least to spare."),
            (-0.97, "Trial 9 has much to spare: validate --trial 9 tests it."),
        ],
    )
    def test_a_trial_that_kept_all_limits(self, make_study, excess, advice):
        """A limit that is kept with ease is not what blocks."""
        kept = Nearest(9, "real_time", 2.0 * (1.0 + excess), excess)
        facts = replace(
            by_hand(make_study()), blocker=Blocker.MARGIN, nearest=kept, loosened=(), beyond=()
        )
        assert advice in advice_in_words(facts)
        assert len(advice_in_words(facts)) == 2

    def test_a_death(self, make_study):
        facts = replace(by_hand(make_study()), blocker=Blocker.DEATHS, blocking=(), died=14)
        assert blocker_in_words(facts) == "14 of 20 trials failed: axis: stalled"
        assert advice_in_words(facts)[0].startswith("See why test runs fail first")

    def test_of_a_limit_that_no_trial_came_to_nothing_is_said(self, facts):
        found = facts((), ())
        assert reasons_in_words(found) == ()
        assert blocker_in_words(found) == "2 of 2 trials failed: axis: stalled"

    @pytest.mark.parametrize(
        ("chance", "order"),
        [
            (0.12, ["--resume", "--from", "replay", "--bounds"]),
            (0.001, ["--from", "--resume", "replay", "--bounds"]),
        ],
    )
    def test_commands(self, make_study, chance, order):
        """Half as many trials again, and the wider range last."""
        facts = replace(by_hand(make_study()), chance=chance)
        verdict = Verdict(state=State.INFEASIBLE, trial=9, infeasible=facts)
        commands = [step.command for step in next_steps(verdict, "run")]
        assert all(word in command for word, command in zip(order, commands, strict=True))
        assert "tune --resume run --trials 30" in commands

    def test_files_have_the_facts(self, make_study):
        verdict = Verdict(state=State.INFEASIBLE, trial=9, infeasible=by_hand(make_study()))
        found = as_mapping(verdict)["infeasible"]
        assert found["nearest"] == {
            "trial": 9, "limit": "real_time", "value": 2.3071, "excess": 0.15355,
        }  # fmt: skip
        assert notes_of_file(verdict, make_study())[0].startswith("DO NOT USE: not within limits")
