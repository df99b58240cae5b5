"""What goes wrong on ROS nodes, and what the tuner makes of it."""

import os
import shlex
import signal

import pytest
from waiting import count_in

from bo_tuner.trials import EvaluationState, TrialState

pytestmark = [pytest.mark.ros, pytest.mark.slow]


class TestBadInput:
    @pytest.mark.parametrize("domain", ["abc", "-1", "233"])
    def test_a_domain_that_is_none(self, tune, domain):
        line = tune(ROS_DOMAIN_ID=domain).refusal()
        assert line == f"ROS_DOMAIN_ID is '{domain}'; expected a number from 0 to 232"

    def test_nodes_that_do_not_run(self, tune):
        command = tune("--attach", ROS_DOMAIN_ID=os.environ["ROS_DOMAIN_ID"])
        assert command.refusal() == (
            f"axis: no such node in ROS domain {os.environ['ROS_DOMAIN_ID']}; no other node runs "
            "there (--attach starts no node: start yours, or set their ROS_DOMAIN_ID)"
        )

    def test_no_executable(self, tune, drive_study):
        study = drive_study()
        study["nodes"]["axis"]["executable"] = "axis_motor"
        assert tune(study=study).refusal() == (
            "drive: no executable axis_motor; install the package or source its workspace"
        )

    def test_an_executable_that_cannot_run(self, tune, tmp_path):
        (tmp_path / "prefix/lib/drive/axis_drive").write_text("#!/no/such/interpreter\n")
        assert "axis_drive: cannot be started: No such file" in tune().refusal()

    def test_a_node_that_exits_at_once(self, tune, tmp_path):
        line = tune(DRIVE="exit").refusal()
        assert line.startswith("axis_drive ended with exit code 1; its last line is ")
        assert "no such bus', see " in line
        assert "no such bus" in (tmp_path / line.split(", see ")[1]).read_text()

    def test_constants_that_are_refused(self, tune, drive_study):
        study = drive_study()
        study["nodes"]["axis"]["parameters"] = {"limit": -1.0}
        assert tune(study=study).refusal() == (
            "nodes.axis.parameters: axis refused its parameters: limit: -1.0 is negative"
        )

    def test_ros_arguments_of_no_use(self, tune):
        command = tune("--ros-args", "--no-such-option")
        assert command.finish() == 2
        assert "error: cannot use --ros-args: " in command.err


class TestSecondTuner:
    @pytest.fixture
    def busy(self, tune):
        """A tuner at work in the domain of the test."""
        command = tune("--trials", "1000", ROS_DOMAIN_ID=os.environ["ROS_DOMAIN_ID"])
        command.wait_for_trial(0)
        return command

    def test_is_refused(self, tune, busy, tmp_path):
        domain = os.environ["ROS_DOMAIN_ID"]
        elsewhere = tmp_path / "elsewhere"
        elsewhere.mkdir()
        # Of another user or machine, which shares no lock with us.
        foreign = {"TMPDIR": str(elsewhere)}
        for arguments, environment, complaint in [
            (["--attach"], {}, f"another tuner is running in ROS domain {domain}, namespace /; "),
            ([], {}, f"another tuner is running in ROS domain {domain}, namespace /; "),
            (["--attach"], foreign, "another tuner is running as /bo_tuner; "),
            ([], foreign, f"axis: is already running in ROS domain {domain}; use --attach, or "),
        ]:
            second = tune(*arguments, folder=elsewhere, ROS_DOMAIN_ID=domain, **environment)
            assert second.refusal().startswith(complaint)
        # The first one is not disturbed.
        done = len(busy.err.splitlines())
        busy.wait_for(lambda: len(busy.err.splitlines()) > done + 2, "more trials")
        assert "FAILED" not in busy.err
        busy.popen.send_signal(signal.SIGINT)
        assert busy.finish() == 130


class TestEvaluations:
    def test_results_that_are_none(self, tune):
        """Trials 0 to 3 of two evaluations each; a failed one is the last of its trial."""
        command = tune("--trials", "7", DRIVE="1:nan 2:inf 3:garbage 4:missing 6:failed 7:foreign")
        assert command.finish() == 0, command.err
        trials = command.trials()
        assert [trial.reason for trial in trials] == [
            "axis: metric peak is nan",
            "axis: metric peak is inf",
            "axis: metric peak is garbage",
            "axis: metric peak is missing",
            "axis: stalled at 3 mm",
            "",
            "",
        ]
        for trial in trials:
            evaluation = trial.evaluations[-1]
            if trial.state is TrialState.FAILED:
                assert evaluation.outcome.state is EvaluationState.FAILED
                assert evaluation.outcome.metrics == {}
        # Foreign results, published before the true one, had no effect.
        evaluation = trials[5].evaluations[0]
        expected = (trials[5].parameters["gain"] - 0.3) ** 2 + evaluation.context["load"]
        assert evaluation.outcome.metrics == {"error": expected, "peak": 0.2}

    def test_parameters_that_are_refused(self, tune, drive_study):
        study = drive_study()
        study["nodes"]["axis"]["parameters"] = {"limit": 0.5}
        command = tune(study=study)
        assert command.finish() in (0, 3), command.err
        for trial in command.trials():
            gain = trial.parameters["gain"]
            refused = f"axis refused its parameters: gain: {gain} is too much"
            assert trial.reason == (refused if gain > 0.5 else "")
        states = {trial.state for trial in command.trials()}
        assert states == {TrialState.COMPLETE, TrialState.FAILED}

    def test_values_that_the_node_does_not_take(self, tune):
        """It says that it took them, and clamps."""
        command = tune("--trials", "6", CLAMP="0.4")
        assert command.finish() in (0, 3), command.err
        for trial in command.trials():
            gain = trial.parameters["gain"]
            clamped = f"axis: parameter gain is 0.4, expected {gain} (not taken by the node)"
            # Nor does it take the default as safe, which it had when the first trial began.
            parked = "axis: parameter gain is 0.4, expected 0.5 (not taken by the node)"
            unsafe = f"{clamped}; axis is not parked: {parked}"
            assert trial.reason == (unsafe if gain > 0.4 and trial.number > 0 else "")
        states = {trial.state for trial in command.trials()}
        assert states == {TrialState.COMPLETE, TrialState.FAILED}

    def test_constants_that_the_node_does_not_take(self, tune, drive_study):
        study = drive_study()
        study["nodes"]["axis"]["parameters"] = {"gain": 0.7}
        study["parameters"] = {"limit": study["parameters"]["gain"]}
        assert tune(study=study, CLAMP="0.4").refusal() == (
            "nodes.axis.parameters: axis: parameter gain is 0.4, expected 0.7 "
            "(not taken by the node)"
        )

    def test_a_node_that_dies_is_replaced(self, tune):
        command = tune(DRIVE="3:die")
        assert command.finish() == 0, command.err
        assert [trial.reason for trial in command.trials()] == [""] * 4
        (lost,) = command.lost()
        assert lost.outcome.reason == "axis_drive was ended by SIGKILL"
        assert lost.trial == 1

    # One that is stopped still looks alive to the operating system.
    @pytest.mark.parametrize("order", ["mute", "stop"])
    def test_a_node_that_stays_silent_is_replaced(self, tune, drive_study, order):
        study = drive_study(trigger={"timeout": 5.0})
        command = tune(study=study, DRIVE=f"2:{order}")
        assert command.finish() == 0, command.err
        assert [trial.reason for trial in command.trials()] == [""] * 4
        (lost,) = command.lost()
        assert lost.outcome.reason == "no result of the test run from axis within 5 s"

    def test_one_that_always_dies_fails_every_trial(self, tune):
        """It ends no run: another parameter set may keep it alive."""
        command = tune(DRIVE="all:die")
        assert command.finish() == 3
        trials = command.trials()
        assert [trial.state for trial in trials] == [TrialState.FAILED] * 4
        assert all("it died twice with these parameters" in trial.reason for trial in trials)
        assert len(command.lost()) == 4

    def test_one_that_is_silent_in_the_validation_leaves_the_verdict_incomplete(
        self, tune, drive_study, tmp_path
    ):
        """It is completed by the command that comes next."""
        study = drive_study(trigger={"timeout": 5.0})
        command = tune()
        assert command.finish() == 0, command.err
        # The last cut is one of the default, which is second in every other draw.
        last = int((tmp_path / "cuts").read_text()) - 1
        command = tune(study=study, folder=tmp_path / "again", DRIVE=f"{last}:mute")
        assert command.finish() == 1, command.err
        assert command.out.startswith("Incomplete: 1 of 2 test runs was lost with the nodes")
        line = command.out.partition("next:")[2].strip().splitlines()[0]
        name, *arguments = shlex.split(line)[:3]
        assert name == "tune"
        command.start(*arguments)
        assert command.finish() == 0, command.err
        assert "; no limit broken in 2 test runs" in command.out.splitlines()[0]


class TestEnd:
    @pytest.mark.parametrize("cut", [3, 9], ids=["tuning", "validation"])
    def test_an_interruption(self, tune, tmp_path, cut):
        """Ctrl-C in a terminal goes to the whole process group."""
        command = tune(DRIVE=f"{cut}:mute")
        counter = tmp_path / "cuts"
        command.wait_for(lambda: count_in(counter) == cut, "the cut")
        os.killpg(command.popen.pid, signal.SIGINT)
        assert command.finish() == 130
        assert len(command.trials()) == (cut - 1) // 2
        assert (command.run_folder / "evaluations.csv").read_text().count("\n") == cut

    def test_at_the_start(self, tune):
        command = tune()
        command.wait_for(command.nodes, "the node")
        command.popen.send_signal(signal.SIGTERM)
        assert command.finish() == 143

    def test_a_killed_tuner_takes_its_nodes_along(self, tune):
        command = tune("--trials", "1000")
        command.wait_for_trial(0)
        assert len(command.nodes()) == 1
        assert command.shared_memory() == []
        command.popen.kill()
        command.popen.wait()
        command.wait_for_nodes_to_end()
        assert len(command.trials()) >= 1
