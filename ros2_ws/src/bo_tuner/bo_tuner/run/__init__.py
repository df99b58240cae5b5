"""A run on disk: its folder, its journal of cuts and trials, and what it was made of.

`folder` makes and locks it, `journal` writes and `journal_reader` reads what was measured, `record`
reads a run as a whole, `provenance` tells what produced it.
"""
