"""Filters: every past pose is marginalised."""
