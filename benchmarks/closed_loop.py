"""Cost of a cut over that of its parts.

All figures are ratios of times taken side by side, since a time alone says more of the machine than
of the program. Median and range are over the repetitions.
"""

import argparse
import contextlib
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

# One thread each, as the tuner gives to its nodes; read when numpy is imported.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import numpy as np
import osqp
import rclpy
from common import opened, provenance, result_parser, table, write_result
from rclpy.executors import ExternalShutdownException
from rclpy.signals import SignalHandlerOptions
from scipy import sparse
from sensor_msgs.msg import JointState

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.study.study_file import load_study
from bo_tuner.trials import Evaluation, EvaluationState, Stage
from bo_tuner.tuning.driver import Driver
from feed_axis_common.ros.messages import LOOP_QOS, VelocityPublisher, from_stamp
from feed_axis_common.ros.process import make_executor
from mpc_controller.controller import MpcController
from mpc_controller.kalman_filter import kalman_filter
from mpc_controller.mpc import SOLVER_SETTINGS, Mpc
from mpc_controller.qp import condense

SAMPLES = 270
CONTEXT = {"stiffness_factor": 1.0, "damping_factor": 1.0}
STUDY = load_study("benchmark")
PARAMETERS = STUDY.search_space().defaults
REPLY_TIMEOUT = 10.0


def seconds(work: Callable[[], Any]) -> float:
    """Wall time of a call [s]."""
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def evaluation(backend: Any, seed: int = 1) -> None:
    """Run one cut of the hand-tuned parameter set; a failed one ends the benchmark."""
    planned = Evaluation(0, 0, Stage.DRAWN, PARAMETERS, CONTEXT, seed)
    outcome = Driver(backend).evaluate(planned).outcome
    if outcome.state is not EvaluationState.COMPLETE:
        raise SystemExit(f"error: a cut failed: {outcome.reason}")


class BareSteps:
    """The OSQP solves and filterpy steps of one cut, from a recording of it, and nothing else."""

    def __init__(self) -> None:
        self._linear_terms: list[np.ndarray] = []
        self._loop: list[tuple[float, float]] = []
        self._record()
        s = self._settings
        model = s.model()
        self._program = condense(model, s.control_horizon, s.prediction_horizon, s.lambda_mpc)
        self._filter = lambda: kalman_filter(
            model,
            s.measurement_variance,
            s.lambda_kf,
            model.equilibrium(0.5, s.gain),
            s.lambda_disturbance,
        )

    def _record(self) -> None:
        solve, step = Mpc.solve, MpcController.step

        def recording_solve(mpc: Mpc, x: Any, last_input: float, preview: Any) -> Any:
            self._linear_terms.append(mpc._linear @ np.concatenate((x, (last_input,), preview)))
            return solve(mpc, x, last_input, preview)

        def recording_step(controller: MpcController, measurement: float) -> Any:
            result = step(controller, measurement)
            self._loop.append((measurement, result.command))
            self._settings = controller.settings
            return result

        Mpc.solve, MpcController.step = recording_solve, recording_step  # type: ignore[method-assign]
        try:
            with opened(InProcessBackend(STUDY)) as backend:
                evaluation(backend)
        finally:
            Mpc.solve, MpcController.step = solve, step  # type: ignore[method-assign]
        if len(self._loop) != SAMPLES:
            raise SystemExit(f"error: the cut has {len(self._loop)} samples, not {SAMPLES}")

    def time(self) -> float:
        """Wall time of all solves and filter steps [s]; setting them up does not count."""
        horizon = self._program.P.shape[0]
        solver = osqp.OSQP()
        solver.setup(
            P=sparse.eye(horizon, format="csc"),
            q=np.zeros(horizon),
            A=sparse.csc_matrix(self._program.inputs),
            l=np.full(horizon, self._settings.input_lower),
            u=np.full(horizon, self._settings.input_upper),
            **SOLVER_SETTINGS,
        )
        kf = self._filter()

        def steps() -> None:
            for q, (measurement, command) in zip(self._linear_terms, self._loop, strict=True):
                kf.update(measurement)
                solver.update(q=q)
                # OSQP takes Ctrl-C for itself while it solves.
                if solver.solve(raise_error=False).info.status == "interrupted":
                    raise KeyboardInterrupt
                kf.predict(command)

        return seconds(steps)


class Echo:
    """A process that sends each message back; ``--echo`` runs it."""

    def __init__(self) -> None:
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node("ping", context=self._context)
        self._ping = VelocityPublisher(self._node, "ping")
        self._node.create_subscription(JointState, "pong", self._on_answer, LOOP_QOS)
        self._executor = make_executor_in(self._context)
        self._executor.add_node(self._node)
        self._answered = -1
        self._process = subprocess.Popen([sys.executable, __file__, "--echo"])
        deadline = time.monotonic() + REPLY_TIMEOUT
        while not (self._ping.subscription_count and self._node.count_publishers("pong")):
            if time.monotonic() > deadline:
                raise SystemExit("error: the echo process does not come up")
            self._executor.spin_once(timeout_sec=0.1)

    def _on_answer(self, message: JointState) -> None:
        self._answered = from_stamp(message.header.stamp)

    def round_trips(self) -> None:
        """As many round trips as a cut has samples, one after the other."""
        for number in range(SAMPLES):
            self._ping.publish("x_axis", number, 0.5)
            deadline = time.monotonic() + REPLY_TIMEOUT
            while self._answered != number:
                self._executor.spin_once(timeout_sec=0.1)
                if time.monotonic() > deadline:
                    raise SystemExit(f"error: round trip {number} has no answer")
        self._answered = -1

    def close(self) -> None:
        """End both."""
        self._process.terminate()
        self._process.wait()
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()


def make_executor_in(context: Any) -> Any:
    """Make the nodes' executor in another context than the default one."""
    return type(make_executor())(context=context)


def echo() -> None:
    """Answer pings until terminated."""
    rclpy.init()
    node = rclpy.create_node("pong")
    pong = node.create_publisher(JointState, "pong", LOOP_QOS)
    node.create_subscription(JointState, "ping", pong.publish, LOOP_QOS)
    executor = make_executor()
    executor.add_node(node)
    with contextlib.suppress(ExternalShutdownException):
        while True:
            executor.spin_once(timeout_sec=0.1)


def spread(ratios: list[float], target: float | None = None) -> dict[str, float | None]:
    """Median and range of ratios, with the target that the median is to keep."""
    return {
        "median": statistics.median(ratios),
        "lowest": min(ratios),
        "highest": max(ratios),
        "target": target,
    }


def run(repetitions: int, path: Path) -> None:
    """Measure, write the result file and print."""
    about = provenance()
    bare = BareSteps()
    with (
        tempfile.TemporaryDirectory() as log,
        opened(InProcessBackend(STUDY)) as inprocess,
        opened(RosBackend(STUDY, Path(log))) as ros,
    ):
        # After the backend, which has put domain and discovery into the environment.
        pings = Echo()
        try:
            for warm_up in (
                lambda: evaluation(inprocess),
                bare.time,
                lambda: evaluation(ros),
                pings.round_trips,
            ):
                warm_up()
            numerics, transport, laps, shares = [], [], [], []
            for repetition in range(repetitions):
                in_process = seconds(lambda r=repetition: evaluation(inprocess, r))
                numerics.append(in_process / bare.time())
                over_ros = seconds(lambda r=repetition: evaluation(ros, r))
                lap = seconds(pings.round_trips)
                transport.append(over_ros / (1.5 * lap + in_process))
                laps.append(lap / in_process)
                shares.append(over_ros / in_process)
        finally:
            pings.close()
        ratios = {
            "cut in process / its bare solves and filter steps": spread(numerics, 3.0),
            f"cut over ROS / (1.5 × {SAMPLES} round trips + cut in process)": spread(
                transport, 1.0
            ),
            f"{SAMPLES} round trips / cut in process": spread(laps),
            "cut over ROS / cut in process": spread(shares),
        }
    write_result(path, {"provenance": about, "ratios": ratios})
    rows = [
        [what, r["median"], r["lowest"], r["highest"], r["target"]] for what, r in ratios.items()
    ]
    print(table(["ratio", "median", "lowest", "highest", "target"], rows))


def main() -> None:
    """Read the options and run."""
    parser = result_parser(__doc__, "closed_loop.json")
    parser.add_argument("--repetitions", type=int, default=30, help="default: %(default)s")
    parser.add_argument("--echo", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.echo:
        echo()
    else:
        run(arguments.repetitions, arguments.result)


if __name__ == "__main__":
    main()
