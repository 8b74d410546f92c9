"""Grades and the formats they leave in."""
