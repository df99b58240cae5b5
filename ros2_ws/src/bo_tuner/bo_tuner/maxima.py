"""The largest numbers and sizes that are accepted; docs/interfaces.md has the same table.

Larger ones would exhaust memory or patience. They are far above what the method is made for: some
hundreds of trials, some tens of tuned parameters.
"""

TRIALS = 10_000
EVALUATIONS = 10_000
"""Contexts drawn, or searched, in a trial."""
TEST_RUNS = 100_000
"""Draws of a validation or a certificate."""
NODES = 100
PARAMETERS = 500
"""Tuned, tied and fixed parameters."""
TUNED = 200
CONDITIONS = 50
"""Conditions between parameters."""
CHOICES = 50
"""Choices of a tuned text."""
CONTEXTS = 50
SIGNALS = 100
WORKERS = 100
"""Workers of a run: each takes one of the 101 ROS domains of a machine, and the run another."""
STEPS = 100
"""Steps in each part of a run: before, start, after and recover."""
WARM_UPS = 1_000
"""Runs to warm up."""
STREAM_RATE = 1_000.0
"""Messages of a stream in a second."""
STREAM_TOPICS = 20
"""Topics of a stream."""
SINES = 1_000
"""Sines of a multisine."""
METRICS = 200
CONSTRAINTS = 50
OBJECTIVES = 3
"""Objectives, the first one included; a front of more cannot be shown in a figure."""
CONSTANTS = 1_000
"""Constant parameters of a node, and values in a list."""
MAGNITUDE = 1e90
"""Size of a number that is computed with, such as a bound, a limit or a metric. The models square
responses and so take them up to 1e100, and the estimate of a worst case lies some standard
deviations above the metrics that it comes from."""
TIMEOUT = 86_400.0
"""Timeout of an evaluation [s]."""
MEGABYTES = 10_000_000
"""Size of all bags of a run together [MB]."""
ANSWER = 1_000
"""Keys in the message in which a node reports an evaluation."""
MESSAGE_BYTES = 10_000_000
"""Size of a result, a parameter event or a message with a signal; a larger one is not decoded."""
MESSAGES_BYTES = 200_000_000
"""Size of all messages of a run in a signal of whole messages."""
JOURNAL_BYTES = 2_000_000_000
FILE_BYTES = 50_000_000
"""Size of a summary, a certificate or a parameter file."""
RESPONSE = 1e100
"""Magnitude of a response that a model is fitted to, or estimates."""
