"""What ends with a campaign that is cut off; the processes of one are in test_command.py."""

import dataclasses
import queue
import signal
import time
from unittest.mock import Mock

import pytest

from bo_tuner.errors import RunError
from bo_tuner.interruption import Interrupted, Interruption
from tuning_benchmark.campaign import execution
from tuning_benchmark.campaign.records import Records
from tuning_benchmark.campaign.tasks import tasks_of
from tuning_benchmark.experiments.experiment_file import load_experiment


class LateQueue(queue.Queue):
    """A queue whose writer goes on for a while after its item has been taken."""

    def put(self, item, *arguments):
        super().put(item, *arguments)
        time.sleep(0.3)


@pytest.fixture
def conduct(experiment_file, tmp_path, monkeypatch):
    """Function that conducts the tasks of the valley, with a thread that is late."""
    monkeypatch.setattr(execution.queue, "Queue", LateQueue)

    def conduct(jobs, tell, **fields):
        tasks = [
            dataclasses.replace(task, **fields)
            for task in tasks_of(load_experiment(str(experiment_file)))
        ]
        versions = {task.name: task.version for task in tasks}
        with Records(tmp_path / "closed.jsonl", versions) as records:
            execution.conduct(
                tasks, records, Mock(Interruption), jobs=jobs, cluster="", about={}, tell=tell
            )

    return conduct


def test_a_campaign_that_is_aborted_leaves_no_thread_behind(conduct):
    """Its process would end without its clean-up: joblib warned of that after the last line."""
    with pytest.raises(RunError, match="another version of the code"):
        conduct(1, print, version="other")
    assert not execution.at_work()


def test_a_campaign_of_several_processes_that_is_interrupted_leaves_no_thread_behind(conduct):
    def interrupted(record):
        raise Interrupted(signal.SIGTERM, "the test")

    with pytest.raises(Interrupted):
        conduct(2, interrupted)
    assert not execution.at_work()
