"""Runs as files and as tables: stored ones, those of a program, those of other systems."""
