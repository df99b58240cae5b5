"""What the harness promises to those who run the tests."""

import subprocess
import sys

import pytest
from commands import environment
from reaper import marked
from waiting import wait_until

TEST_PROCESS = """\
import os
import subprocess
import sys
import time

import reaper

reaper.guard()
subprocess.Popen(["sleep", "600"], start_new_session=True)
print(os.environ[reaper.MARK], flush=True)
if sys.argv[1] == "killed":
    time.sleep(600)
"""


@pytest.mark.parametrize("end", ["ended", "killed"])
def test_nothing_outlives_a_test_process(end):
    command = [sys.executable, "-W", "ignore", "-c", TEST_PROCESS, end]
    with subprocess.Popen(command, env=environment(), stdout=subprocess.PIPE, text=True) as process:
        try:
            mark = process.stdout.readline().strip()
            assert len(mark) == 32
            if end == "killed":
                wait_until(lambda: len(marked(mark)) == 1, "what it has started")
        finally:
            # The end of the block waits for it.
            process.kill()
    wait_until(lambda: marked(mark) == [], "the end of what it started")
