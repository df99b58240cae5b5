"""How good an answer really is, from many more evaluations than a tuner has."""
