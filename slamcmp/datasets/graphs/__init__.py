"""Logs from graph files."""
