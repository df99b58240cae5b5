"""Watching a run while it goes on: terminal, JSON lines, topics and services."""
