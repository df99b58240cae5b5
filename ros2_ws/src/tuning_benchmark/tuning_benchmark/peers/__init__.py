"""Optimizers of others, each by its own recommended use, behind `tuning_benchmark.optimizer`.

One module each; the product imports none of them. All see the same `Observation`: the objective on
the study's scale for surrogates, and each constraint's excess, here relative to its limit.
"""
