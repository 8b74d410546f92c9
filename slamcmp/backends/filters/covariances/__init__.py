"""Joint covariances changed in place by a few named verbs."""
