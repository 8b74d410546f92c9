"""What an experiment file says, checked, and the trials it expands to."""
