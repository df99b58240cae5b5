"""Counts messages of a topic that the middleware has lost."""


class LostMessages:
    """Counts the gaps in the numbers that a publisher gives its messages.

    Where there are several publishers a gap means nothing: each of them counts on its own.

    Attributes
    ----------
    count
        Number of lost messages since it was last set to zero.
    """

    def __init__(self) -> None:
        self.count = 0
        self._latest = 0

    def note(self, number: int | None, publishers: int) -> None:
        """Take note of a message."""
        number = 0 if number is None or publishers > 1 else number
        # A publisher that was started anew begins again.
        if 0 < self._latest < number:
            self.count += number - self._latest - 1
        self._latest = number
