"""OSQP takes SIGINT for itself while it solves; the process is to hear it all the same."""

import json
import queue
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from commands import ONE_THREAD, environment, finish, start
from waiting import DEADLINE, in_mask, wait_until

from bo_tuner.study.study_file import load_study, study_to_mapping

# Solves one program after the other; says each signal, and how the solver ends before and after it.
PROGRAM = """
import os
import signal
import threading

import numpy as np

from feed_axis_common.model import delay_augmented, feed_axis
from mpc_controller import mpc as mpc_module
from mpc_controller.mpc import Mpc
from mpc_controller.qp import condense

said = ""

def say(text):
    global said
    if text != said:
        said = text
        # A handler that interrupts a print can print nothing itself.
        os.write(2, text.encode() + b"\\n")

mpc_module.SOLVER_SETTINGS |= {settings}
signal.signal(signal.SIGINT, lambda signum, frame: say("SIGINT"))
if {with_thread}:
    threading.Thread(target=threading.Event().wait, daemon=True).start()
model = delay_augmented(*feed_axis(1.0, 1.0, 26.0), 0.02, 0.02)
mpc = Mpc(condense(model, 20, 20, -5.0), 0.0, 1.2)
rng = np.random.default_rng(1)
while True:
    say(mpc.solve(rng.uniform(0.0, 1.2, 3), 0.5, rng.uniform(0.3, 0.9, 20)).status)
"""
# No solution is exact enough, so that a signal comes in the midst of a solve.
ENDLESS = {"max_iter": 50_000, "eps_abs": 0.0, "eps_rel": 1e-30}


@pytest.mark.parametrize(
    ("settings", "with_thread", "status", "signals"),
    [
        (ENDLESS, False, "maximum iterations reached", 20),
        (ENDLESS, True, "maximum iterations reached", 20),
        # Of so many, some come when the solution is found and not returned yet.
        ({}, False, "solved", 200),
    ],
    ids=["endless", "endless, with a thread", "solved"],
)
def test_no_signal_is_lost(settings, with_thread, status, signals):
    program = PROGRAM.format(settings=settings, with_thread=with_thread)
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        env=environment(**ONE_THREAD),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    said = queue.Queue()
    reader = threading.Thread(target=lambda: [said.put(line.strip()) for line in process.stderr])
    reader.start()
    try:
        assert said.get(timeout=DEADLINE) == status
        for _ in range(signals):
            process.send_signal(signal.SIGINT)
            assert said.get(timeout=DEADLINE) == "SIGINT"
            assert said.get(timeout=DEADLINE) == status
    finally:
        process.kill()
        process.wait()
        reader.join()
        process.stderr.close()


SLOW = f"""
from pathlib import Path

from mpc_controller import mpc
from mpc_controller.controller import MpcController

mpc.SOLVER_SETTINGS |= {ENDLESS | {"max_iter": 1000}}

class Slow(MpcController):
    def step(self, measurement):
        Path("solves").touch()
        return super().step(measurement)
"""


def test_a_run_in_process_ends(tmp_path):
    (tmp_path / "slow.py").write_text(SLOW)
    study = json.loads(json.dumps(study_to_mapping(load_study("benchmark").replace(trials=2))))
    study["nodes"]["controller"]["object"] = "slow:Slow"
    (tmp_path / "study.yaml").write_text(json.dumps(study))
    options = ("--study", "study.yaml", "--backend", "inprocess")
    process = start("tune", *options, folder=tmp_path, without=ONE_THREAD)
    wait_until((tmp_path / "solves").exists, "the first solve", process)
    others = [
        task
        for task in Path(f"/proc/{process.pid}/task").iterdir()
        if task.name != str(process.pid)
    ]
    assert others, "there are those of the linear algebra"
    assert all(in_mask(task, "SigBlk", signal.SIGINT) for task in others)
    process.send_signal(signal.SIGINT)
    assert finish(process)[0] == 130
