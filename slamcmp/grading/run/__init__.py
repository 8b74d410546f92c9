"""Grading one submission and a whole class."""
