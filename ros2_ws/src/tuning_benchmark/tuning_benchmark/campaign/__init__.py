"""A campaign as independent tasks: what each does, how they are carried out, and their records."""
