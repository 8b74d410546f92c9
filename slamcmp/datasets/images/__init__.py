"""Recordings of cameras, and their calibrations."""
