"""What validation is to show of the run that is validated, and the certificates that it leaves."""

import json

from draws_needed import draws_needed_without_event

CHANCE = {
    "peak": {"kind": "worst_case", "metric": "peak", "upper": 1.0},
    "error": {"kind": "chance", "metric": "error", "upper": 9.0, "probability": 0.96},
}
# The first certificate has four fifths of the error probability.
NEEDED = draws_needed_without_event(0.04, 0.8 * 0.05)


def certificate(folder, number=1):
    return json.loads((folder / "certificates" / f"{number:04d}.json").read_text())
