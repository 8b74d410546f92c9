"""``slamcmp advise``: which back end for this robot, in words, from a short paired experiment."""
