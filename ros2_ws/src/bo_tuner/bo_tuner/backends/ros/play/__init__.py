"""Plays bags to nodes, in lockstep."""
