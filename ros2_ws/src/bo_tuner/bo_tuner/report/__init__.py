"""The report of a run: one HTML page that explains its result with figures."""
