"""Which parameters to try next, which to recommend, and when to stop."""
