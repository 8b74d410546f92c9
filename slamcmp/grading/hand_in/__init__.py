"""What a student hands in, read without running it."""
