"""Simulated logs with exact truth."""
