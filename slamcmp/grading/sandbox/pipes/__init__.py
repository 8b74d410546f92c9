"""How grader and worker talk, neither trusting what arrives."""
