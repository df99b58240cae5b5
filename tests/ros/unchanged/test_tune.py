"""``tune`` on a controller and a motor that run by themselves: paused, and ended by a signal."""

import signal

import pytest
from commands import Fork, finish
from example_nodes import UNCHANGED, start_script
from std_msgs.msg import Float64
from std_srvs.srv import SetBool

from bo_tuner.study import strict_yaml

pytestmark = pytest.mark.ros

SAFE, FOUND = 0.25, 0.375
HALT = -0.125


@pytest.fixture
def running(ros_environment, tmp_path):
    """Controller and motor, with a gain that is neither the default nor safe."""
    started = []
    for node, arguments in (("motor", []), ("pid", ["--ros-args", "-p", f"kd:={FOUND}"])):
        log = tmp_path / f"{node}.txt"
        started.append(start_script(UNCHANGED / f"{node}_node.py", log, *arguments))
    yield
    for process in started:
        process.kill()
        process.wait()


@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_pause_and_a_signal_leave_the_machine_safe(running, peer, tmp_path, signum):
    study = strict_yaml.parse((UNCHANGED / "study.yaml").read_text()).value
    halt = {"publish": {"topic": "/setpoint", "message": {"data": HALT}}}
    study["run"] |= {"after": [halt], "end": {"after": 1.0}}
    study["park"] = {"parameters": {"kp": SAFE}}
    (tmp_path / "study.yaml").write_text(strict_yaml.dump(study))
    setpoints = peer.record(Float64, "setpoint")
    peer.get_parameters("pid", ["kp"])

    def await_run():
        def runs_or_ended():
            return tune.poll() is not None or any(m.data == 1.0 for m in setpoints)

        peer.spin_until(runs_or_ended, "a run")
        assert tune.poll() is None, finish(tune)

    tune = Fork("tune", "--study", "study.yaml", "--attach", "--quiet", folder=tmp_path)
    try:
        if signum == signal.SIGTERM:
            # Of a trial, at work.
            await_run()
            assert peer.call(SetBool, "tuner/pause", SetBool.Request(data=True)).success
            peer.spin_until(lambda: peer.get_parameters("pid", ["kp"]) == [SAFE], "the pause")
            peer.spin_for(1.0)
            assert peer.get_parameters("pid", ["kp", "ki", "kd"]) == [SAFE, 0.0, 0.02]
            assert peer.call(SetBool, "tuner/pause", SetBool.Request(data=False)).success
        setpoints.clear()
        await_run()
        setpoints.clear()
        tune.send_signal(signum)
        code, _, err = finish(tune)
    finally:
        tune.kill()
    assert code == 128 + signum, err
    peer.spin_until(lambda: any(m.data == HALT for m in setpoints), "the steps after the run")
    # What the study names as safe stays, the rest is as it was found.
    assert peer.get_parameters("pid", ["kp", "ki", "kd"]) == [SAFE, 0.0, FOUND]
