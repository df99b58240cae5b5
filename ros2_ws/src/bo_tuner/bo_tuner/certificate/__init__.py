"""The certificate of a parameter set: what fresh evaluations show of it, and how robust it is.

`certification` runs the evaluations and `worst_case_search` looks for the contexts that hurt most;
`verdict` judges what they found (`evidence`) with the bounds of `risk`. `neighbourhood`,
`robustness` and `winners_curse` add what a user should know beside the verdict. `record` puts all
of it into a file, `table` onto the terminal.
"""
