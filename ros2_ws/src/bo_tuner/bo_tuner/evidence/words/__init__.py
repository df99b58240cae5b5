"""What screens and files say of facts: one function for each kind, and every sentence once.

`facts` has the sentences on what speaks against a parameter set and on what else to know, `limits`
those on a limit, `verdict` those on a result, `infeasible` why there is none, and `next_steps` what
to do; `terminal` and `junit` print them.
"""
