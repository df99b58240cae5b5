"""Comparison of tuning algorithms over many runs, with tables and figures."""
