"""One's own log in plain files."""
