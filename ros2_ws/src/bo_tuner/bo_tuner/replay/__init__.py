"""Recorded evaluations once more, compared and put side by side."""
