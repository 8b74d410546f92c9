"""How sure the numbers are, and what they say about publications and about honesty."""
