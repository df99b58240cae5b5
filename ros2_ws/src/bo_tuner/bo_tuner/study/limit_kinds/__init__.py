"""The kinds of limits, a module each; `registry` has them by the name in a study file.

A kind is one class. It says what of a metric is limited, and to the models how to predict it;
whether samples keep the limit; how a certificate shows that with confidence; and its words. What is
common to limits on single runs is in `on_runs`, and to those on a mean in `on_mean`. A kind knows
nothing of a study but its limit, `limited`; whoever needs one of these asks `Constraint.rule`.
"""
