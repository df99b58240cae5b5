"""The kinds of limits, a module each; `registry` has them by the name in a study file.

A kind is one class. It says which property of a metric is limited, how models predict it, and
whether samples keep the limit; how a certificate shows that with confidence is in
`bo_tuner.evidence.limit_proof`, and its words are in `words.limit_kinds` there. What limits on
single runs have in common is in `on_runs`, and limits on a mean in `on_mean`. A kind knows nothing
of a study but its limit, `limited`; `Constraint.rule` is the kind of a constraint.
"""
