"""What is known of the result of a run: the verdict, which every screen and file shows.

`differences` compares two parameter sets beyond chance; `limit_verdict` holds what was found of a
limit, and `verdict` of the result, in numbers and in words; `quantities` derives the numbers from
evaluations, `at_bounds` lists the parameters at a bound, and `effects` those that move nothing.
`infeasible` has in numbers why nothing was found feasible, and `infeasible_words` says it.
`validated` makes the verdict by the validation of a run, and `run_verdict` by its certificate if it
has one (`bo_tuner.evidence.certificate`); `table` prints it.
"""
