"""A bag for each run that was aborted, with what the signals said in the 5 s before."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

from bo_tuner.metrics.latest_messages import LatestMessage
from bo_tuner.recording.bag import Message, TrialBag, make_topic
from bo_tuner.storage.run_files import ABORTS
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Outcome


class AbortBags:
    """Writes the bags of a run; call it with each run that was aborted.

    What they are for is a look at the machine, so they are written whatever else is recorded. The
    time of a message is that of its arrival.
    """

    def __init__(self, folder: Path, study: Study, warn: Callable[[str], None]) -> None:
        self._folder = folder / ABORTS
        self._study = study
        self._warn = warn

    def __call__(
        self, planned: Evaluation, outcome: Outcome, latest: Sequence[LatestMessage]
    ) -> None:
        """Write the bag of an evaluation."""
        messages, unknown = _known(latest)
        notes = {
            "study": self._study.name,
            "stage": str(planned.stage),
            "trial": str(planned.trial),
            "evaluation": str(planned.index),
            "parameters": json.dumps(dict(planned.parameters)),
            "context": json.dumps(dict(planned.context)),
            "seed": str(planned.seed),
            "state": str(outcome.state),
            "reason": outcome.reason,
        } | ({"unknown_types": ", ".join(unknown)} if unknown else {})
        try:
            self._folder.mkdir(exist_ok=True)
            number = 1 + sum(path.is_dir() for path in self._folder.iterdir())
            bag = TrialBag(self._folder / f"{number:04d}")
            bag.write(messages, notes)
            bag.finish(notes)
        except OSError as error:
            self._warn(
                f"warning: no bag of the aborted run: {self._folder}: {error.strerror or error}"
            )


def _known(
    latest: Sequence[LatestMessage],
) -> tuple[list[tuple[int, Message]], list[str]]:
    """Return times [ns] and messages of types that a bag can have, and the other types."""
    messages, unknown = [], {}
    for item in latest:
        try:
            topic = make_topic(item.topic, item.type)
        except KeyError:
            unknown[item.type] = True
            continue
        messages.append((item.received, (topic, item.data)))
    return messages, list(unknown)
