"""Motion and sensor models with their Jacobians and noise."""
