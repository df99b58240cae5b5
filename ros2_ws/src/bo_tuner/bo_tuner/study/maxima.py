"""The largest numbers and sizes that are accepted; docs/interfaces.md has the same table.

Beyond them memory or patience would end before the run does. They are far above what the method
is made for: some hundreds of trials, some tens of tuned parameters.
"""

TRIALS = 10_000
EVALUATIONS = 10_000
"""Contexts drawn, or searched, in a trial."""
DRAWS = 100_000
"""Of a validation or a certificate."""
NODES = 100
PARAMETERS = 500
"""Tuned, tied and fixed ones."""
TUNED = 50
CONDITIONS = 50
"""Between parameters."""
CHOICES = 50
"""Of a tuned text."""
CONTEXTS = 50
SIGNALS = 100
WORKERS = 100
"""Of a run: each has a ROS domain of its own, of the 101 on a machine, and so has the run."""
STEPS = 100
"""In each part of a run: before, start, after and recover."""
STREAM_RATE = 1_000.0
"""Messages of a stream in a second."""
STREAM_TOPICS = 20
"""Of a stream."""
SINES = 1_000
"""Of a multisine."""
METRICS = 200
CONSTRAINTS = 50
OBJECTIVES = 3
"""The first and the further ones; with more, a front cannot be looked at."""
CONSTANTS = 1_000
"""Constant parameters of a node, and values in a list."""
MAGNITUDE = 1e90
"""Size of a number that is computed with, such as a bound, a limit or a metric. The models square
responses and so take them up to 1e100, and the estimate of a worst case lies some standard
deviations above the metrics that it comes from."""
TIMEOUT = 86_400.0
"""Of an evaluation [s]."""
MEGABYTES = 10_000_000
"""Of all bags of a run."""
ANSWER = 1_000
"""Keys in what a node says of an evaluation."""
MESSAGE_BYTES = 10_000_000
"""Of a result, an event of parameters or a message with a signal; a larger one is not decoded."""
MESSAGES_BYTES = 200_000_000
"""Of all messages of a run in a signal of whole messages."""
JOURNAL_BYTES = 2_000_000_000
FILE_BYTES = 50_000_000
"""Of a summary, a certificate or a parameter file."""
