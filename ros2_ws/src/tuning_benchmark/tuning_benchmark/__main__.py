"""``python -m tuning_benchmark``: the command without an installation's scripts."""

from tuning_benchmark.executable import benchmark

if __name__ == "__main__":
    benchmark()
