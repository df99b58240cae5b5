"""Algorithms I to IV of the paper (Sec. 5.1), and V with a joint model."""
