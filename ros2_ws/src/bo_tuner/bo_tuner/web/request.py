"""What the page may ask of the run."""

from enum import StrEnum

from bo_tuner.tuning.question import Reply


class Request(StrEnum):
    """A request, as it stands in its address and in the pipe to the run."""

    PAUSE = "pause"
    CONTINUE = "continue"
    FINISH = "finish"
    ABORT = "abort"


WORDS = (*Request, *Reply)
"""All requests, and the answers to the question whether the next parameter set may be tried."""
