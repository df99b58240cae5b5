"""The certificate of a parameter set: what fresh evaluations prove about it, and how robust it is.

`certification` has the plans carried out: `draws`, then `worst_contexts`, which
`independent_search` looks for; `plan` is what they have in common. `judgement` makes `findings` of
them, with the confidence sequences of `numerics.sequential`. `parameter_sensitivity`,
`context_tolerance` and `winners_curse` add what a user should know beside the verdict. `making`
puts all of it into a `certificate`, and `store` keeps the files. `claim` says in facts what it
claims, and what speaks against it.
"""
