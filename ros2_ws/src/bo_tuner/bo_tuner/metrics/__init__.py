"""From what the nodes report of an evaluation to the metrics of the study."""
