"""Live views of a run: terminal, JSON lines, topics and services."""
