"""The names that the script replaces in the product, to measure them."""

import subprocess
import sys
from pathlib import Path

import live_overhead


def test_every_name_that_is_measured_exists():
    # In a process of its own, whose classes nobody else needs.
    code = "from live_overhead import Meter, install; install(Meter())"
    folder = Path(live_overhead.__file__).parent
    subprocess.run([sys.executable, "-c", code], cwd=folder, check=True)
