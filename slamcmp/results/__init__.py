"""The stored tables of an experiment, and what is read out of them."""
