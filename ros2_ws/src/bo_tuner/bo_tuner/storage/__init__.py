"""A run on disk: its folder, its journal of evaluations and trials, and its provenance."""
