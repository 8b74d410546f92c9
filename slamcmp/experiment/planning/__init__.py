"""Which trials an experiment expands to, under which keys, and what of them is left to run."""
