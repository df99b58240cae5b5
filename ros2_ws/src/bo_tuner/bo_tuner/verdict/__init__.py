"""The verdict on the result of a run, which every screen and file shows.

`differences` compares two parameter sets beyond chance; `verdict` holds what was found, in numbers
and in words; `quantities` derives the numbers from evaluations; `validated` makes the verdict of a
run, and `table` prints it. With a certificate, `bo_tuner.certificate.run_verdict` makes it.
"""
