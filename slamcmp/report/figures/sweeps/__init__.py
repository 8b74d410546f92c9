"""Figures over what an experiment swept."""
