"""What the page may ask of the run."""

from enum import StrEnum


class Request(StrEnum):
    """A request, as it stands in its address and in the pipe to the run."""

    PAUSE = "pause"
    CONTINUE = "continue"
    FINISH = "finish"
    ABORT = "abort"
    ACCEPT = "accept"
    REFUSE = "refuse"
    END = "end"


ANSWERS = (Request.ACCEPT, Request.REFUSE, Request.END)
"""Answers to the question whether the next parameter set may be tried."""
