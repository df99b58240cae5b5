"""The report of a run: one page that explains its result in pictures."""
