"""Mistakes made by rule: the solution with one thing done otherwise."""
