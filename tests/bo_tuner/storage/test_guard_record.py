"""Acts of guards on record."""

import json

from bo_tuner.storage.guard_record import Act, add_act, read_acts
from bo_tuner.storage.run_files import GUARD_RECORD


def test_those_of_all_workers_are_in_the_order_of_time(tmp_path):
    acts = {"worker-2": "2026-01-02", "worker-1": "2026-01-03", ".": "2026-01-01"}
    for name, time in acts.items():
        (tmp_path / name).mkdir(exist_ok=True)
        add_act(tmp_path / name / GUARD_RECORD, Act(time, f"of {name}", 0.0, 0.1))
    with (tmp_path / "worker-1" / GUARD_RECORD).open("a") as file:
        number = {"time": 5, "reason": "", "stop_seconds": 0.0, "safe_seconds": 0.1, "problems": []}
        file.write(json.dumps(number) + "\ncut o")
    reasons = [act.reason for act in read_acts(tmp_path)]
    assert reasons == ["of .", "of worker-2", "of worker-1"]
    assert read_acts(tmp_path / "none") == []
