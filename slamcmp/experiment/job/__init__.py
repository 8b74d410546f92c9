"""One job in a process of its own: a back end on a stream, timed and scored."""
