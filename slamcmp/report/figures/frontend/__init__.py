"""Figures of what a front end did."""
