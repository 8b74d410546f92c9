"""What an experiment answers: in sentences, and which back end to take."""
