"""What the commands return to the shell."""

EXIT_OK = 0
EXIT_FAULT = 1
EXIT_USAGE = 2
EXIT_INFEASIBLE = 3
EXIT_SIGNAL = 128
"""Plus the number of the signal."""
