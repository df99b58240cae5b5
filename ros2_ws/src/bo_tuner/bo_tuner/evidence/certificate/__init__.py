"""The certificate of a parameter set: what fresh evaluations prove about it, and how robust it is.

`certification` runs the evaluations, and `independent_search` looks for the worst contexts;
`judgement` makes `findings` of them, with the bounds of `sequential`. `parameter_sensitivity`,
`context_tolerance` and `winners_curse` add what a user should know beside the verdict.
`certificate` writes all of it to a file, and `table` gives its rows to terminal and report.
"""
