"""When a guard acts, told in heartbeats and times; nothing runs."""

import pytest

from bo_tuner.backends.ros.guard.messages import END, IDLE, PERIOD, RUN, Beat, State
from bo_tuner.backends.ros.guard.plan import Patience, patience
from bo_tuner.backends.ros.guard.watch import CYCLE, Watch
from bo_tuner.errors import BackendError

TIMEOUT = 0.5
FIRM = Patience(TIMEOUT, TIMEOUT)
WIDENED = Patience(TIMEOUT, 1.5)


def beat(phase=IDLE, run=0, acts=0):
    return Beat("guard", phase, run, acts)


def watching(phase=IDLE, patience=FIRM):
    watch = Watch(patience)
    watch.beat(beat(phase), 0.0)
    return watch


class TestHeartbeats:
    def test_before_the_first_one_nothing_is_watched(self):
        watch = Watch(FIRM)
        watch.hang_up()
        assert watch.due(100.0) is None

    def test_silence_for_as_long_as_was_said_is_not_too_long(self):
        watch = watching()
        assert watch.due(TIMEOUT) is None
        assert watch.due(TIMEOUT + 0.01).takes_over

    def test_stuttering_ones_are_enough(self):
        watch, now = watching(RUN), 0.0
        for gap in (0.1, 0.4, 0.05, 0.45, 0.3, 0.49) * 5:
            now += gap
            assert watch.due(now) is None
            watch.beat(beat(RUN), now)

    def test_a_guard_that_did_not_run_itself_has_missed_them(self):
        watch = watching()
        watch.wake(7.0)
        assert watch.due(7.1) is None
        assert watch.due(7.6) is not None

    def test_a_process_that_has_ended_is_not_waited_for(self):
        watch = watching()
        watch.hang_up()
        assert "has ended" in watch.due(0.001).reason
        watch.act()
        assert watch.due(10.0) is None

    def test_after_the_last_one_nothing_is_watched(self):
        watch = watching()
        watch.beat(beat(END), 0.1)
        watch.hang_up()
        assert watch.due(100.0) is None
        assert not watch.is_watching


class TestBusyComputer:
    """Late heartbeats widen the patience by their delay, up to a bound, and for a while."""

    def test_by_the_largest_delay(self):
        watch = watching(patience=WIDENED)
        for now in (0.4, 0.5):
            watch.beat(beat(), now)
        late = 0.4 - PERIOD
        assert watch.timeout == pytest.approx(TIMEOUT + late, abs=0.01)
        assert watch.due(0.5 + TIMEOUT + late - 0.02) is None
        assert watch.due(0.5 + TIMEOUT + late + 0.02) is not None

    def test_never_beyond_its_bound_however_late_they_come(self):
        watch, now = watching(patience=WIDENED), 0.0
        for _ in range(20):
            now += watch.timeout
            assert watch.due(now) is None
            watch.beat(beat(), now)
        assert watch.timeout == WIDENED.most
        assert "set BO_TUNER_GUARD_TIMEOUT" in watch.due(now + 1.51).reason

    def test_not_where_somebody_has_named_the_time(self):
        watch = watching()
        watch.beat(beat(), 0.49)
        assert watch.timeout == TIMEOUT

    def test_a_computer_that_is_free_again_is_forgiven(self):
        watch = watching(patience=WIDENED)
        watch.beat(beat(), 0.5)
        for k in range(1, 601):
            watch.beat(beat(), 0.5 + PERIOD * k)
        assert watch.timeout == pytest.approx(TIMEOUT, abs=1e-6)

    @pytest.mark.parametrize(
        ("guard", "variable", "expected"),
        [
            (None, "", (0.5, 1.5)),
            ({"timeout": 0.5}, "", (0.5, 0.5)),
            ({"timeout": 3.0}, "", (3.0, 3.0)),
            (None, "0.8", (0.8, 0.8)),
            ({"timeout": 3.0}, "0.8", (3.0, 3.0)),
            (None, "4", (4.0, 4.0)),
        ],
    )
    def test_who_says_how_patient_it_is(self, make_study, monkeypatch, guard, variable, expected):
        monkeypatch.setenv("BO_TUNER_GUARD_TIMEOUT", variable)
        changes = {} if guard is None else {"guard": guard}
        assert patience(make_study(**changes)) == expected

    def test_a_variable_that_is_no_time_is_refused(self, make_study, monkeypatch):
        monkeypatch.setenv("BO_TUNER_GUARD_TIMEOUT", "0.1")
        with pytest.raises(BackendError, match=r"GUARD_TIMEOUT: .*expected 0\.3 to 86400 s"):
            patience(make_study())


class TestAfterAnAct:
    def test_it_acts_once_and_holds_until_the_tuner_knows(self):
        watch = watching()
        watch.due(1.0)
        watch.act()
        assert (watch.acts, watch.is_known) == (1, False)
        # The tuner lives again, and has not looked yet.
        watch.beat(beat(acts=0), 2.0)
        assert (watch.due(9.0), watch.is_known) == (None, False)
        watch.beat(beat(acts=1), 9.0)
        assert watch.is_known
        assert watch.due(9.6) is not None

    def test_a_tuner_that_dies_then_may_have_begun_to_set_something(self):
        watch = watching()
        watch.act()
        watch.beat(beat(acts=0), 2.0)
        watch.hang_up()
        assert watch.due(2.1) is not None


class TestCondition:
    def test_the_tuner_has_a_cycle_to_act(self):
        watch = watching(RUN)
        watch.held(0.2)
        assert watch.due(0.19 + CYCLE) is None
        assert "abort condition" in watch.due(0.21 + CYCLE).reason

    def test_a_run_that_has_ended_meanwhile_has_been_aborted(self):
        for after in (beat(IDLE), beat(RUN, run=1)):
            watch = watching(RUN)
            watch.held(0.2)
            watch.beat(after, 0.25)
            assert watch.due(0.4) is None

    def test_between_runs_it_means_nothing(self):
        watch = watching(IDLE)
        watch.held(0.1)
        assert watch.due(0.4) is None


class TestPresence:
    def test_a_node_that_was_away_is_made_safe_while_the_tuner_stays_in_control(self):
        watch = watching()
        watch.presence("/servo", True)
        assert watch.due(0.1) is None
        watch.presence("/servo", False)
        assert watch.due(0.2) is None
        watch.presence("/servo", True)
        cause = watch.due(0.3)
        assert ("/servo" in cause.reason, cause.takes_over) == (True, False)
        assert watch.due(0.3) is None

    def test_before_a_tuner_is_there_nodes_come_and_go(self):
        watch = Watch(FIRM)
        for is_there in (True, False, True):
            watch.presence("/servo", is_there)
        watch.beat(beat(), 0.0)
        assert watch.due(0.1) is None


def test_messages_are_read_back_and_others_passed_over():
    state = State("a", "b", "c", ("/servo",), ("/setpoint",), 2, "why", "what", True, False, True)
    assert State.read(str(state)) == state
    assert Beat.read(str(beat(RUN, 3, 1))) == beat(RUN, 3, 1)
    for text in ("", "{", "[1]", "7", "{}", str(state)):
        assert Beat.read(text) is None
