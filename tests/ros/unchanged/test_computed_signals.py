"""Signals beyond single fields: reductions, frames, whole messages and a path against its plan."""

import math
import re
from functools import partial

import pytest
from field_robot import Frames, Planner, Scanner, StillFrames
from servo import failure, run
from signal_runs import record_run
from waiting import wait_until

from bo_tuner import maxima
from bo_tuner.backends.ros import signals as recorders
from bo_tuner.replay.recompute import recompute
from bo_tuner.storage.record import read_run
from bo_tuner.trials import EvaluationState

pytestmark = pytest.mark.ros

CLEARANCE = {"topic": "scan", "field": "min(finite(ranges), range_max)"}
# What holds at the start is then of now.
RUN = {"before": [{"wait": 0.2}], "end": {"after": 0.6}}


def in_frames(target, source, field):
    return {"topic": "frames", "frames": [target, source], "field": field}


def mean(signal):
    return {"of": signal, "measure": "mean"}


def metrics(made):
    """What runs come to; on a busy machine one may be disturbed."""
    for _ in range(3):
        found = run(made)
        if found.state is EvaluationState.COMPLETE:
            return found.metrics
    raise AssertionError(found.reason)


def test_the_clearance_of_a_scan(backend, join):
    scanner = join(Scanner)
    made = backend(
        signals={
            "clearance": CLEARANCE,
            "beams": {"topic": "scan", "field": "len(finite(ranges))"},
        },
        run=RUN,
        metrics={
            "clearance": {"of": "clearance", "measure": "minimum"},
            "beams": {"of": "beams", "measure": "maximum"},
        },
    )
    found = metrics(made)
    assert (found["clearance"], found["beams"]) == (2.5, 2.0)
    scanner.ranges = [math.inf]
    assert metrics(made)["clearance"] == 30.0


def test_values_that_are_not_finite_fail_a_run_unless_they_are_left_out(backend, join):
    scanner = join(partial(Scanner, ranges=[1.0, math.nan]))
    made = backend(signals={"nearest": {"topic": "scan", "field": "min(ranges)"}}, run=RUN)
    assert failure(run(made)).startswith("signal nearest (scan) is nan at ")
    scanner.ranges = []
    wait_until(lambda: "has no values" in failure(run(made)), "an empty scan")


def test_a_reduction_aborts_a_run(backend, join):
    join(partial(Scanner, ranges=[0.2, 5.0]))
    made = backend(
        signals={"clearance": CLEARANCE},
        run=RUN | {"abort_when": "clearance < 0.3 and t > 0.1"},
    )
    assert "aborted at 0.1" in failure(run(made))


def test_where_one_frame_is_in_another_over_a_chain(backend, join):
    """map → odom, told rarely, odom → base, told often, and base → laser, told once.

    The second is turned by a right angle about z: what is ahead of base is at its left in map.
    """
    join(partial(Frames, "map", "odom", x=10.0, yaw=math.pi / 2.0, rate=10.0))
    join(partial(Frames, "odom", "base", x=2.0))
    join(partial(StillFrames, "base", "laser", x=0.5))
    made = backend(
        signals={
            "x": in_frames("map", "laser", "translation.x"),
            "y": in_frames("map", "laser", "translation.y"),
            "yaw": in_frames("map", "laser", "yaw(rotation)"),
            "far": in_frames("laser", "map", "norm(translation)"),
        },
        run=RUN,
        metrics={name: mean(name) for name in ("x", "y", "yaw", "far")},
    )
    found = metrics(made)
    assert found["x"] == pytest.approx(10.0)
    assert found["y"] == pytest.approx(2.5)
    assert found["yaw"] == pytest.approx(math.pi / 2.0)
    assert found["far"] == pytest.approx(math.hypot(10.0, 2.5))
    assert made.recording.signals["x"].late == 0


def test_a_moving_frame_is_interpolated_at_the_time_of_the_one_behind(backend, join):
    """A base at 3 m/s in odom, of which map knows at 10 Hz: at each stamp it is where it was."""
    join(partial(Frames, "map", "odom", rate=10.0))
    join(partial(Frames, "odom", "base", speed=3.0))
    made = backend(
        signals={"x": in_frames("map", "base", "translation.x")},
        run={"end": {"after": 1.5}},
        metrics={"speed": {"of": "x", "measure": "total_variation_rate"}},
    )
    metrics(made)
    seen = made.recording.signals["x"]
    slopes = [
        (after - before) / (later - earlier)
        for earlier, later, before, after in zip(
            seen.time, seen.time[1:], seen.value, seen.value[1:], strict=False
        )
    ]
    assert 5 < len(slopes) < 50, "it goes on with the one behind, not at 50 Hz"
    assert slopes == pytest.approx([3.0] * len(slopes), rel=1e-6)


@pytest.mark.parametrize(
    ("frames", "complaint"),
    [
        (["map", "bas"], "/frames: no frame 'bas'; did you mean 'base'?"),
        (["map", "wheel"], "/frames: no frame 'wheel'; expected one of base, map, odom, world"),
        (["map", "odom"], "map and odom are not connected: the one is in world, the other in odom"),
    ],
)
def test_frames_that_nobody_places(refusal, join, monkeypatch, frames, complaint):
    monkeypatch.setattr(recorders, "FRAMES", 1.0)
    join(partial(Frames, "world", "map"))
    join(partial(Frames, "odom", "base"))
    signals = {"x": in_frames(*frames, "translation.x")}
    found = refusal(signals=signals)
    assert found.startswith("signals.x.frames: ")
    assert complaint in found


def test_a_frame_that_is_placed_no_more(backend, join, leave):
    base = join(partial(Frames, "odom", "base"))
    join(partial(Frames, "map", "odom"))
    made = backend(
        signals={"x": in_frames("map", "base", "translation.x") | {"largest_gap": 0.3}},
        run={"end": {"after": 3.0}},
    )
    assert run(made).state is EvaluationState.COMPLETE
    leave(base)
    assert "signal x (frames map base) has no message for" in failure(run(made))


def test_a_frame_that_is_known_only_later(backend, join, monkeypatch):
    """A topic that is silent may have it yet; a run without it says what there is instead."""
    monkeypatch.setattr(recorders, "FRAMES", 0.3)
    base = partial(Frames, "odom", "base", rate=0.01)
    silent = join(base)
    made = backend(signals={"x": in_frames("map", "base", "translation.x")}, run=RUN)
    assert "signal x (frames map base) has 0 messages in a run" in failure(run(made))
    silent.publisher.publish(silent.message())
    wait_until(
        lambda: "; there is no frame 'map'; expected one of base, odom" in failure(run(made)),
        "the other frames",
    )


def test_a_frame_that_two_nodes_place(backend, refusal, join, leave):
    """Two filters that both tell where the base is: somebody has forgotten one."""
    join(partial(Frames, "odom", "base", name="ekf"))
    made = backend(
        signals={"x": in_frames("odom", "base", "translation.x")}, run={"end": {"after": 1.0}}
    )
    assert run(made).state is EvaluationState.COMPLETE
    other = join(partial(Frames, "odom", "base", name="wheels"))
    found = run(made)
    assert found.unusable
    expected = "the transform of base has 2 publishers (/ekf and /wheels), whose messages mix"
    assert found.reason == expected or "stand still or go back" in found.reason
    made.close()
    assert "(/ekf and /wheels), whose messages would mix" in refusal(
        signals={"x": in_frames("odom", "base", "translation.x")}
    )
    leave(other)


def test_a_topic_without_transforms(refusal, join):
    join(Scanner)
    wrong = {"topic": "scan", "frames": ["map", "base"], "field": "translation.x"}
    assert "carries sensor_msgs/msg/LaserScan, expected transforms: tf2_msgs/msg/TFMessage" in (
        refusal(signals={"x": wrong})
    )


def test_a_transform_has_no_such_field(refusal, join):
    join(partial(Frames, "map", "base"))
    found = refusal(signals={"x": in_frames("map", "base", "translation.w")})
    assert found.startswith("signals.x.field: geometry_msgs/msg/Vector3 has no field 'w'")


def test_the_deviation_of_a_path_from_its_plan(backend, join):
    """The robot goes along y = 0; the plan is 1 m beside that, and from the next run on 2 m."""
    planner = join(Planner)
    join(partial(Frames, "map", "base", x=1.0, speed=0.1))
    signals = {
        "x": in_frames("map", "base", "translation.x"),
        "y": in_frames("map", "base", "translation.y"),
        "plan": {"topic": "plan", "minimum_messages": 0},
    }
    deviation = {"path": ["x", "y"], "plan": "plan", "measure": "mean"}
    made = backend(signals=signals, run=RUN, metrics={"deviation": deviation})
    assert metrics(made)["deviation"] == pytest.approx(1.0)
    assert made.recording.messages["plan"].time[0] < 0.0
    planner.plan(2.0)
    assert metrics(made)["deviation"] == pytest.approx(2.0)


def test_a_bag_gives_the_metrics_of_the_run_again(backend, join, tmp_path):
    """Bit for bit: of a reduction, of frames, of a plan, and of a function of whole messages."""
    join(Planner)
    join(Scanner)
    join(partial(Frames, "map", "base", x=1.0, speed=0.3, yaw=0.4))
    (tmp_path / "plan_metrics.py").write_text(
        "def poses(signals):\n    return len(signals['plan'][1][-1].poses)\n"
    )
    made = backend(
        signals={
            "clearance": CLEARANCE,
            "x": in_frames("map", "base", "translation.x"),
            "y": in_frames("map", "base", "translation.y"),
            "heading": in_frames("map", "base", "yaw(rotation)"),
            "plan": {"topic": "plan", "minimum_messages": 0},
        },
        run=RUN,
        metrics={
            "clearance": mean("clearance - x"),
            "heading": mean("heading"),
            "deviation": {"path": ["x", "y"], "plan": "plan", "measure": "rms"},
            "poses": {"python": "plan_metrics:poses"},
        },
        folder=str(tmp_path),
    )
    live = metrics(made)
    assert (live["poses"], live["heading"]) == (2.0, pytest.approx(0.4))
    record = read_run(record_run(tmp_path / "run", made._study, {0.5: [made.recording]}))
    (again,) = recompute(record, record.study)
    assert again.outcome.metrics == live


def test_more_whole_messages_than_a_run_may_have(backend, join, monkeypatch):
    join(Scanner)
    made = backend(signals={"scans": {"topic": "scan"}}, run=RUN)
    metrics(made)
    assert len(made.recording.messages["scans"].data) > 10
    monkeypatch.setattr(maxima, "MESSAGES_BYTES", 1000)
    assert re.fullmatch(
        "signal scans has [0-9]+ bytes of messages, expected at most 1000 in a run",
        failure(run(made)),
    )


def test_whole_messages_of_a_type_that_is_not_of_ros_itself(refusal, join, monkeypatch):
    join(Planner)
    monkeypatch.setattr("bo_tuner.backends.ros.readers.is_known", lambda name: False)
    assert "nav_msgs/msg/Path is none of ROS's own types, of which whole messages are kept" in (
        refusal(signals={"plan": {"topic": "plan"}})
    )
