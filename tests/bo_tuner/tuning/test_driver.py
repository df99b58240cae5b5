"""What all plans have in common, carried out by the driver with one task at a time or several."""

from collections import deque
from dataclasses import replace

import numpy as np
import pytest
from functions import Watcher

from bo_tuner.backends.recorded import RecordedEvaluations
from bo_tuner.errors import RunError
from bo_tuner.evidence.certificate.certification import Certification
from bo_tuner.evidence.certificate.plan import Subject
from bo_tuner.methods.registry import METHODS
from bo_tuner.models.fantasies import fantasies
from bo_tuner.plans import BatchPlan, Event, EventKind, Phase, Plan, Run, Runs, finished_after
from bo_tuner.run_notes import Death, Notes
from bo_tuner.storage.journal_reader import in_order_of_plans
from bo_tuner.trials import (
    Evaluation,
    EvaluationState,
    Outcome,
    Stage,
    TrialState,
)
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.gate import Gate
from bo_tuner.tuning.loop import TrialPlan, Tuning
from bo_tuner.tuning.validation import ValidationPlan

WINDOWS = (1, 2, 4, 8)
SEVERAL = {"gain": 0.25}


def figures(gain, load, seed):
    """A parabola, and a peak near its limit of 1."""
    noise = np.random.default_rng(seed).normal(0.0, 0.02, 2)
    return {
        "error": 1.0 + (gain - 0.6) ** 2 + 0.05 * load + noise[0],
        "peak": 0.4 + 0.35 * gain * load + noise[1],
    }


@pytest.fixture
def study(make_study):
    return make_study(
        budget={
            "trials": 6,
            "initial_trials": 3,
            "validation_draws": 4,
            "drawn_contexts": 2,
            "search_evaluations": 1,
        }
    )


class Disorderly:
    """Begins all that it can have at once; results come in another order, which a seed decides."""

    name = "function"

    def __init__(self, backend, seed):
        self._backend = backend
        self._rng = np.random.default_rng(seed)
        self.most = 0

    def run(self, evaluations):
        while begun := list(evaluations):
            self.most = max(self.most, len(begun))
            done = list(self._backend.run(begun))
            for k in self._rng.permutation(len(done)):
                yield done[k]


class Asked(Plan):
    """Another plan, and what it was asked and told, in this order."""

    def __init__(self, plan):
        self.plan = plan
        self.phase, self.what, self.attempts = plan.phase, plan.what, plan.attempts
        self.steps = plan.steps
        self.log = []
        self._numbers = {}

    def ask(self, pending):
        task = self.plan.ask(pending)
        numbers = tuple(self._numbers[id(item)] for item in pending)
        if task is not None:
            # Kept, so that no other task gets its id.
            self._numbers[id(task)] = len(self._numbers)
            self.log.append(("ask", self._numbers[id(task)], numbers, task))
        return task

    def tell(self, task):
        self.log.append(("tell", self._numbers[id(task)]))
        return self.plan.tell(task)

    @property
    def sequence(self):
        return [entry[:3] for entry in self.log]


def of_trials(method):
    def run(study, driver):
        return list(Tuning(study, driver, METHODS[method]))

    return run


def of_answer(method):
    def run(study, driver):
        # Always the same trials.
        trials = _TRIALS[method]
        search = METHODS[method].answer_search(study, trials, 8)
        driver.complete(search)
        return search.answer

    return run


def of_validation(study, driver):
    plan = ValidationPlan(study, [study.search_space().defaults, SEVERAL])
    driver.complete(plan)
    return plan.results


def of_certificate(study, driver):
    certification = Certification(study, driver, confidence=0.9)
    suspected = ({"load": 1.7},)
    subjects = [Subject("default", {"gain": 0.5}), Subject("tuned", SEVERAL, suspected)]
    return certification.collect(subjects, 35)


def of_known_runs(study, driver):
    planned = [Evaluation(0, k, Stage.NOMINAL, SEVERAL, {"load": 1.5}, k) for k in range(5)]
    plan = Runs(planned)
    driver.complete(plan)
    return plan.evaluations


_TRIALS = {}

PHASES = {
    **{f"trials {name}": of_trials(name) for name in ("IV", "boundary")},
    **{f"answer {name}": of_answer(name) for name in ("IV", "boundary")},
    "validation": of_validation,
    "certificate": of_certificate,
    "runs": of_known_runs,
}


@pytest.fixture(params=PHASES)
def phase(request, study, function_backend):
    kind, _, name = request.param.partition(" ")
    if kind == "answer" and name not in _TRIALS:
        _TRIALS[name] = of_trials(name)(study, Driver(function_backend(study, figures)))
    return PHASES[request.param]


class Killed(BaseException):
    pass


class Journaling(Watcher):
    """Keeps evaluations that are not on record yet; is killed after so many."""

    def __init__(self, most=None):
        super().__init__()
        self.kept = []
        self._most = most

    def evaluation(self, evaluation):
        super().evaluation(evaluation)
        if not evaluation.recorded:
            self.kept.append(evaluation)
            if len(self.kept) == self._most:
                raise Killed


class TestEveryPlan:
    @pytest.mark.parametrize("window", WINDOWS)
    def test_the_result_follows_from_the_window_alone(self, study, function_backend, phase, window):
        """Whatever the order in which results come."""
        backend = function_backend(study, figures)
        expected = phase(study, Driver(backend, window=window))
        for seed in range(2):
            disorderly = Disorderly(function_backend(study, figures), seed)
            assert phase(study, Driver(disorderly, window=window)) == expected
            assert 1 <= disorderly.most <= window

    @pytest.mark.parametrize("window", [1, 4])
    def test_a_phase_that_was_killed_repeats_what_it_did(
        self, study, function_backend, phase, window
    ):
        """After any evaluation: what is on record is not run again, and the rest is the same."""
        whole = Journaling()
        backend = function_backend(study, figures)
        expected = phase(study, Driver(backend, whole, window=window))
        count = len(whole.kept)
        for most in sorted({1, count // 2, count - 1} & set(range(1, count))):
            killed = Journaling(most)
            with pytest.raises(Killed):
                phase(study, Driver(function_backend(study, figures), killed, window=window))
            again = Journaling()
            recorded = RecordedEvaluations(function_backend(study, figures), study, killed.kept)
            assert phase(study, Driver(recorded, again, window=window)) == expected
            # As a journal is read: which of several tasks is run first is of no account.
            assert in_order_of_plans(killed.kept + again.kept) == in_order_of_plans(whole.kept)

    def test_with_a_window_several_are_under_way(self, study, function_backend):
        for name in ("trials IV", "validation", "certificate", "runs"):
            disorderly = Disorderly(function_backend(study, figures), 0)
            PHASES[name](study, Driver(disorderly, window=4))
            assert disorderly.most == 4


class TestWindow:
    @pytest.mark.parametrize("window", WINDOWS)
    @pytest.mark.parametrize("disorder", [None, 0, 1])
    def test_which_tasks_are_pending(self, study, function_backend, window, disorder):
        """Task k is planned when those up to k - q are told, and knows those in between."""
        backend = function_backend(study, figures)
        if disorder is not None:
            backend = Disorderly(backend, disorder)
        plan = Asked(TrialPlan(study, METHODS["II"]))
        list(Driver(backend, window=window).run(plan))
        expected = []
        for k in range(6):
            if k >= window:
                expected.append(("tell", k - window))
            expected.append(("ask", k, tuple(range(max(0, k - window + 1), k))))
        expected += [("tell", k) for k in range(max(0, 6 - window), 6)]
        assert plan.sequence == expected

    @pytest.mark.parametrize("window", [3])
    @pytest.mark.parametrize("method", ["IV", "boundary"])
    @pytest.mark.parametrize("known", [1, 4])
    def test_trials_on_record_are_pending_as_they_were(
        self, study, function_backend, method, window, known
    ):
        def trials(recorded=()):
            driver = Driver(function_backend(study, figures), window=window)
            return list(Tuning(study, driver, METHODS[method], trials=recorded))

        whole = trials()
        assert trials(whole[:known]) == whole[known:]

    @pytest.mark.parametrize("method", ["I", "III", "IV", "V", "boundary"])
    @pytest.mark.parametrize("window", [2, 4])
    def test_no_parameter_set_is_proposed_twice(self, make_study, function_backend, method, window):
        """Not even in a space where there are few, and where the same one looks best to all."""
        window_of = {"node": "axis", "type": "integer", "bounds": [1, 12], "default": 3}
        study = make_study(
            parameters={"window": window_of},
            budget={"trials": 10, "initial_trials": 3},
        )

        def function(window, load, seed):
            return figures(window / 12.0, load, seed)

        driver = Driver(function_backend(study, function), window=window)
        trials = list(Tuning(study, driver, METHODS[method]))
        assert len({trial.parameters["window"] for trial in trials}) == len(trials) == 10
        assert [trial.number for trial in trials] == list(range(10))

    @pytest.mark.parametrize("method", ["IV", "boundary"])
    def test_proposals_under_way_are_apart(self, make_study, function_backend, method):
        """The one that knows of another that is pending looks elsewhere."""
        study = make_study(budget={"trials": 12, "initial_trials": 6})
        known = list(Tuning(study, Driver(function_backend(study, figures)), METHODS[method]))[:8]
        optimizer = METHODS[method].optimizer(study)
        for trial in known:
            optimizer.tell(trial)
        first = optimizer.ask()
        plan = TrialPlan(study, METHODS[method], known)
        tasks = []
        while len(plan.trials) < len(known):
            plan.tell(plan.ask([]))
        tasks.append(plan.ask([]))
        tasks.append(plan.ask(tasks))
        gains = [task.pending.parameters["gain"] for task in tasks]
        assert gains[0] == first.parameters["gain"]
        assert abs(gains[1] - gains[0]) > 1e-3

    def test_the_budget_counts_those_that_are_under_way(self, make_study, function_backend):
        study = make_study(constraints={}, budget={"trials": 9, "initial_trials": 3})
        study = study.replace(evaluations=10)
        driver = Driver(function_backend(study, figures), window=8)
        trials = list(Tuning(study, driver, METHODS["II"]))
        # Five drawn contexts each, unless the study says otherwise.
        assert sum(len(trial.evaluations) for trial in trials) == 10


def test_what_is_believed_of_a_pending_trial_is_the_mean_of_the_models(
    make_study, function_backend
):
    """On a plane without noise the posterior mean is the plane."""
    study = make_study(
        constraints={"peak": {"kind": "worst_case", "metric": "peak", "upper": 9.0}},
        budget={"trials": 12, "initial_trials": 12, "drawn_contexts": 3, "search_evaluations": 2},
    )

    def plane(gain, load, seed):
        return {"error": 2.0 + gain + 0.5 * load, "peak": gain + load}

    trials = list(Tuning(study, Driver(function_backend(study, plane)), METHODS["IV"]))
    pending = replace(
        trials[0],
        number=12,
        parameters={"gain": 0.37},
        state=TrialState.FAILED,
        evaluations=(Evaluation(12, 0, Stage.DRAWN, {"gain": 0.37}, {"load": 1.4}, 0),),
        worst_cases={},
    )
    (believed,) = fantasies(study, trials, [pending], np.random.default_rng(0))
    assert believed.state is TrialState.COMPLETE
    assert believed.parameters == pending.parameters
    (evaluation,) = believed.evaluations
    assert evaluation.outcome.metrics["error"] == pytest.approx(2.0 + 0.37 + 0.7, abs=0.02)
    worst = believed.worst_cases["peak"]
    assert worst.context["load"] == pytest.approx(2.0)
    assert worst.value == pytest.approx(2.37, abs=0.05)


def test_nothing_is_believed_before_a_trial_is_complete(make_study):
    assert fantasies(make_study(), [], [], np.random.default_rng(0)) == []


class TestLosses:
    LOST = Outcome(EvaluationState.LOST, reason="axis was ended by SIGKILL")

    @staticmethod
    def planned(count):
        return [Evaluation(0, k, Stage.NOMINAL, SEVERAL, {"load": 1.5}, k) for k in range(count)]

    @pytest.mark.parametrize("window", [1, 2])
    def test_three_in_a_row_end_a_run(self, study, function_backend, window):
        backend = function_backend(study, lambda **_: self.LOST)
        plan = Runs(self.planned(9), "runs")
        with pytest.raises(RunError, match=r"^3 runs in a row were lost with their nodes: axis w"):
            list(Driver(backend, window=window).run(plan))
        assert len(plan.evaluations) == 3

    def test_those_in_between_do_not(self, study, function_backend):
        fates = iter([True, True, False] * 3)

        def fate(**values):
            return self.LOST if next(fates) else figures(**values)

        plan = Runs(self.planned(9))
        list(Driver(function_backend(study, fate)).run(plan))
        assert len(plan.evaluations) == 9

    def test_it_is_run_again_as_often_as_the_plan_has_it(self, study, function_backend):
        fates = deque([True, True, False, False])

        def fate(**values):
            return self.LOST if fates.popleft() else figures(**values)

        watcher, plan = Watcher(), Runs(self.planned(2))
        plan.attempts = 3
        list(Driver(function_backend(study, fate), watcher).run(plan))
        assert [e.outcome.complete for e in plan.evaluations] == [True, True]
        # Each attempt is on record.
        assert [e.index for e in watcher.evaluations] == [0, 0, 0, 1]


class TestGate:
    def test_a_run_waits_between_evaluations_when_observers_know_all(self, study, function_backend):
        events = []

        class Observer(Watcher):
            def evaluation(self, evaluation):
                events.append("evaluation")
                if len(events) == 2:
                    gate.requests.request(True)

            def pause(self, paused):
                events.append(paused)
                gate.requests.request(False)

        observer = Observer()
        gate = Gate(observer=observer)
        backend = function_backend(study, figures)
        list(Driver(backend, observer, gate=gate).run(Runs(TestLosses.planned(3))))
        assert events == ["evaluation", "evaluation", True, False, "evaluation"]

    def test_it_ends_there(self, study, function_backend):
        watcher = Watcher()

        def check():
            if len(watcher.evaluations) == 2:
                raise Killed

        backend = function_backend(study, figures)
        with pytest.raises(Killed):
            list(Driver(backend, watcher, gate=Gate(check)).run(Runs(TestLosses.planned(9))))
        assert len(backend.calls) == 2


class Requests(Watcher):
    """Asks something of the gate after so many evaluations; keeps events."""

    def __init__(self, asking, after):
        super().__init__()
        self.events = []
        self.gate = Gate(observer=self)
        self._asking = asking
        self._after = after

    def evaluation(self, evaluation):
        super().evaluation(evaluation)
        if len(self.evaluations) == self._after:
            self._asking(self.gate)

    def event(self, event):
        self.events.append(event)

    def pause(self, paused):
        self.gate.requests.request(False)


def halt_and_continue(gate):
    """Let the run go on before it has come to the gate."""
    gate.halt("the guard")
    gate.requests.request(False)


class TestEvents:
    @staticmethod
    def trials(study, backend, watcher, window, recorded=(), finished=None):
        driver = Driver(backend, watcher, window=window, gate=watcher.gate)
        return list(Tuning(study, driver, METHODS["II"], trials=recorded, finished=finished))

    @pytest.mark.parametrize("window", [1, 2, 4])
    def test_trials_that_finish_early(self, study, function_backend, window):
        """Those under way are run to their end, and a resumed run repeats that."""
        backend = function_backend(study, figures)
        watcher = Requests(lambda gate: gate.finish(), 4)
        whole = self.trials(study, backend, watcher, window)
        planned = min(1 + window, 6)
        # Three evaluations each, so that the fourth is of the second one.
        assert watcher.events == [Event("tuning", planned, EventKind.FINISH)]
        assert len(whole) == planned
        nothing = Requests(lambda gate: None, -1)
        for known in range(planned + 1):
            rest = self.trials(study, backend, nothing, window, whole[:known], planned)
            assert rest == whole[known:]
        assert nothing.events == []

    def test_other_phases_go_on(self, study, function_backend):
        watcher = Requests(lambda gate: gate.finish(), 1)
        plan = Runs(TestLosses.planned(3))
        driver = Driver(function_backend(study, figures), watcher, gate=watcher.gate)
        list(driver.run(plan))
        assert len(plan.evaluations) == 3
        assert watcher.events == []

    @pytest.mark.parametrize(
        ("asking", "expected"),
        [
            (lambda gate: gate.requests.request(True), (EventKind.PAUSE, "")),
            (lambda gate: gate.halt("the guard"), (EventKind.GUARD, "the guard")),
            (halt_and_continue, (EventKind.GUARD, "the guard")),
        ],
    )
    def test_a_pause_and_why(self, study, function_backend, asking, expected):
        watcher = Requests(asking, 4)
        self.trials(study, function_backend(study, figures), watcher, 1)
        assert watcher.events == [
            Event("tuning", 2, *expected),
            Event("tuning", 2, EventKind.CONTINUE),
        ]

    def test_what_is_left_to_do_follows_from_the_latest(self):
        finish, extend = (Event("tuning", 3, k) for k in (EventKind.FINISH, EventKind.EXTEND))
        pause = Event("tuning", 4, EventKind.PAUSE)
        assert finished_after([]) is None
        assert finished_after([pause, finish, pause]) == 3
        assert finished_after([finish, extend]) is None
        assert finished_after([finish, extend, replace(finish, tasks=5)]) == 5
        settled = Event(Phase.CHECKING, 2, EventKind.FINISH)
        assert finished_after([finish, settled]) == 3
        assert finished_after([finish, settled], Phase.CHECKING) == 2
        # More trials have another answer.
        assert finished_after([finish, settled, extend], Phase.CHECKING) is None


DIED, DIED_ANYWAY = Death("sim"), Death("sim", anyway=True)


class Mortal:
    """A node dies in some runs, counted from 0; the others are complete."""

    name = "ros"

    def __init__(self, death, deadly):
        self._death = death
        self._deadly = deadly
        self.runs = 0

    def run(self, evaluations):
        for planned in evaluations:
            dies = self._deadly(self.runs)
            self.runs += 1
            if dies:
                outcome = Outcome(
                    EvaluationState.LOST,
                    {},
                    "sim was ended by SIGABRT",
                    notes=Notes(death=self._death),
                )
            else:
                outcome = Outcome(EvaluationState.COMPLETE, {"error": 1.0, "peak": 0.5})
            yield replace(planned, outcome=outcome)


class TestDeaths:
    """Whether a node that dies is a failure of the parameters, in a plan of any kind."""

    @staticmethod
    def results(backend, count=3):
        watcher = Watcher()
        plan = Runs(TestLosses.planned(count))
        list(Driver(backend, watcher).run(plan))
        return [e.outcome for e in plan.evaluations]

    def test_twice_in_a_test_run_is_a_failure(self):
        backend = Mortal(DIED, lambda run: run < 2)
        first, *others = self.results(backend)
        assert (first.state, first.unusable) == (EvaluationState.FAILED, False)
        assert all(outcome.complete for outcome in others)
        assert backend.runs == 4

    def test_however_many_in_a_row_they_end_no_run(self):
        backend = Mortal(DIED, lambda run: True)
        states = {outcome.state for outcome in self.results(backend, 8)}
        assert states == {EvaluationState.FAILED}

    def test_one_that_always_dies_anyway_ends_the_run(self):
        backend = Mortal(DIED_ANYWAY, lambda run: True)
        with pytest.raises(RunError, match="were lost with their nodes: sim was ended by SIGABRT"):
            self.results(backend)

    @pytest.mark.parametrize("method", ["boundary", "IV", "safe"])
    def test_a_deadly_parameter_set_is_learnt_and_never_proposed_again(self, make_study, method):
        """It ends no run, and comes back in no later trial."""
        study = make_study(
            budget={"trials": 8, "initial_trials": 4, "drawn_contexts": 1, "validation_draws": 1}
        )

        class Deadly(Mortal):
            def run(self, evaluations):
                for planned in evaluations:
                    self._deadly = lambda run, gain=planned.parameters["gain"]: gain > 0.55
                    yield from super().run([planned])

        trials = list(Tuning(study, Driver(Deadly(DIED, None)), METHODS[method]))
        assert len(trials) == study.budget.trials
        dead = [t for t in trials if t.parameters["gain"] > 0.55]
        assert {t.state for t in dead} <= {TrialState.FAILED}
        assert not any(t.unusable for t in trials)
        assert len({t.parameters["gain"] for t in dead}) == len(dead)


class TestBatches:
    def test_a_batch_follows_from_all_of_the_one_before(self):
        def batches():
            ran = yield TestLosses.planned(3)
            assert [e.index for e in ran] == [0, 1, 2]
            ran = yield []
            assert ran == []
            ran = yield TestLosses.planned(2)
            return len(ran)

        plan = BatchPlan(batches())
        first = plan.ask([])
        others = [plan.ask([first]), plan.ask([first])]
        assert plan.ask([first, *others]) is None
        for task in (first, *others):
            plan.tell(task)
        more = [plan.ask([]), plan.ask([])]
        for task in more:
            plan.tell(task)
        assert plan.ask([]) is None
        assert plan.result == 2

    def test_one_that_ends_early(self):
        def batches():
            ran = yield TestLosses.planned(5)
            return [e.index for e in ran]

        plan = BatchPlan(batches(), lambda e: e.index == 1)
        for _ in range(2):
            plan.tell(plan.ask([]))
        assert plan.ask([]) is None
        assert plan.result == [0, 1]


class TestBackends:
    def test_one_that_gives_nothing_ends_the_run(self):
        class Silent:
            def run(self, evaluations):
                return iter(())

        with pytest.raises(RunError, match=r"^the backend has given no result$"):
            Driver(Silent()).evaluate(TestLosses.planned(1)[0])

    def test_one_that_runs_something_else_ends_the_run(self):
        class Other:
            def run(self, evaluations):
                for planned in evaluations:
                    yield replace(planned, index=7)

        with pytest.raises(RunError, match=r"test run 7, which was not asked for$"):
            Driver(Other()).evaluate(TestLosses.planned(1)[0])


def test_a_single_evaluation(study, function_backend):
    (planned,) = TestLosses.planned(1)
    done = Driver(function_backend(study, figures)).evaluate(planned)
    assert done.outcome.metrics == pytest.approx(figures(0.25, 1.5, 0))
    task = Run(planned)
    task.tell(done)
    assert task.ask() is None
