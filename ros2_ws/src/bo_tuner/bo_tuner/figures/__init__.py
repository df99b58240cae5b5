"""Figures described independently of a plotting library, and their renderers."""
