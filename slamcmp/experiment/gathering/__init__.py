"""The stored runs of an experiment, put into tables with their manifest."""
