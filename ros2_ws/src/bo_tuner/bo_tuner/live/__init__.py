"""Watching a run while it goes on: status, JSON lines, topics and services, stop advice."""
