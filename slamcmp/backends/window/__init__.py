"""The sliding window: own Gauss–Newton and marginalisation."""
