"""A run in process and all that is made of it, on a machine whose clock stands beyond 2106.

The clock is that of Python, moved before anything else is imported; files have the real times.
"""

import json
import subprocess
import sys

from axis import node, write_study
from commands import environment, python_path, several

from bo_tuner.storage.record import read_run

SITE = """\
import datetime
import sys
import time

# Plotly uses it where it is installed; its extensions crash with a datetime of Python's.
sys.modules["pandas"] = None

AHEAD = {ahead}
real, real_ns = time.time, time.time_ns
time.time = lambda: real() + AHEAD
time.time_ns = lambda: real_ns() + AHEAD * 10**9


class Moved(datetime.datetime):
    @classmethod
    def now(cls, tz=None):
        return cls.fromtimestamp(time.time(), tz)


datetime.datetime = Moved
"""
# 32 bits of seconds end in January 2038, without a sign in February 2106.
AHEAD = 90 * 31_557_600


def test_a_study_beyond_both_ends_of_32_bits(tmp_path, make_study):
    site = tmp_path / "site"
    site.mkdir()
    (site / "sitecustomize.py").write_text(SITE.format(ahead=AHEAD))
    clock = {"PYTHONPATH": python_path(site, tmp_path)}
    now = "import datetime; print(datetime.datetime.now().year)"
    done = subprocess.run(
        [sys.executable, "-c", now], env=environment() | clock, capture_output=True, text=True
    )
    year = done.stdout.strip()
    assert int(year) > 2110

    write_study(tmp_path, make_study(nodes=node("late_axis")))
    commands = [
        ("tune", "--study", "axis.yaml", "--backend", "inprocess"),
        ("tune", "--resume", "latest", "--trials", "6"),
        ("validate", "latest", "--runs", "300"),
        ("report", "latest"),
        ("replay", "latest"),
    ]
    done = subprocess.run(
        several(*commands), cwd=tmp_path, env=environment() | clock, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stdout + done.stderr
    latest = tmp_path / "runs" / "latest"
    assert f"-{year}" in latest.resolve().name
    record = read_run(latest)
    assert record.provenance["started"].startswith(year)
    assert len(record.trials) == 6
    assert all(0.0 <= row.seconds < 100.0 for row in record.evaluations)
    certificate = json.loads((latest / "certificates" / "0001.json").read_text())
    assert certificate["provenance"]["started"].startswith(year)
    assert year in (latest / "report.html").read_text()
