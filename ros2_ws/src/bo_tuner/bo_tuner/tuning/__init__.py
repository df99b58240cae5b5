"""The run: trials, the check of the best candidates, and the validation."""
