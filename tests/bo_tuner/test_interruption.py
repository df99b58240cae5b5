"""What a run makes of signals."""

import signal
import threading

import pytest

from bo_tuner.interruption import Interrupted, Interruption, waited_for

pytestmark = pytest.mark.usefixtures("handlers")


@pytest.mark.parametrize("name", ["INT", "TERM", "HUP", "QUIT", "USR1", "USR2", "ALRM", "XCPU"])
def test_what_would_end_the_process_asks_for_the_end_of_the_run(name):
    """Else the machine would go on with the parameters of a trial."""
    signum = signal.Signals[f"SIG{name}"]
    interruption = Interruption()
    interruption.check()
    signal.raise_signal(signum)
    with pytest.raises(Interrupted, match=signum.name):
        interruption.check()


@pytest.mark.parametrize("signum", [signal.SIGHUP, signal.SIGQUIT])
def test_what_is_ignored_stays_ignored(signum):
    signal.signal(signum, signal.SIG_IGN)
    interruption = Interruption()
    signal.raise_signal(signum)
    interruption.check()


def test_a_machine_is_not_left_to_itself_by_ctrl_z():
    """The nodes that are started do not inherit that."""
    interruption = Interruption()
    interruption.keep_running()
    assert signal.getsignal(signal.SIGTSTP) not in (signal.SIG_DFL, signal.SIG_IGN)
    signal.raise_signal(signal.SIGTSTP)
    interruption.check()


def test_a_real_time_signal_has_a_number():
    assert str(Interrupted(signal.SIGRTMIN + 6)) == f"signal {signal.SIGRTMIN + 6}"


class TestWait:
    def test_what_comes_back_is_returned_or_raised(self):
        assert waited_for(lambda: 3) == 3
        with pytest.raises(KeyError):
            waited_for(lambda: {}["none"])

    def test_what_does_not_is_left_behind(self):
        never = threading.Event()
        with pytest.raises(TimeoutError, match=r"no answer in 0\.01 s"):
            waited_for(never.wait, 0.01)
        interruption = Interruption()
        signal.raise_signal(signal.SIGTERM)
        with pytest.raises(Interrupted, match="SIGTERM"):
            waited_for(never.wait, check=interruption.check)
        never.set()
