"""Recorded cuts once more: `replay` runs them and compares, `bag` puts both side by side."""
