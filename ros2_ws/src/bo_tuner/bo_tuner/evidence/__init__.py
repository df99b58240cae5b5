"""What is known of the result of a run: the verdict, which every screen and file shows.

`facts` are its parts, beside what was found of a limit (`limit_verdict`), of a number (`quantity`),
and why nothing was found feasible (`infeasible`); `words` has every sentence on them.
`validated` makes the verdict by the validation of a run, and `run_verdict` by its certificate if it
has one (`bo_tuner.evidence.certificate`).
"""
