"""Recorded logs and the file formats they come in."""
