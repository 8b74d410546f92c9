"""Configuration, trials, runner, executors and result store."""
