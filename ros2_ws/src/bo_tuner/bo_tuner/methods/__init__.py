"""Methods: how parameters are searched for, and what the answer is."""
