"""From what nodes report, or from recorded signals, to the metrics of the study."""
