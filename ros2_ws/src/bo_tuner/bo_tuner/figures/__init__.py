"""Figures described once, without a plotting library, and their renderers."""
