"""Other optimizers, each used as its authors recommend, behind `tuning_benchmark.peers.optimizer`.

One module each; the tuner imports none of them. All see the same `Observation`: the objective on
the study's scale for surrogates, and each constraint's excess, here relative to its limit.
"""
