"""The verdict on the result of a run, which every screen and file shows.

`differences` compares two parameter sets beyond chance; `limit_verdict` holds what was found of a
limit, and `verdict` of the result, in numbers and in words; `quantities` derives the numbers from
evaluations, `at_bounds` tells which parameters are at a bound, and `effects` which move nothing;
`validated` makes the verdict of a run, and `table` prints it. With a certificate,
`bo_tuner.certificate.run_verdict` makes it.
"""
