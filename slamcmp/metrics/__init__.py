"""Accuracy, consistency and cost: plain functions in a registry."""
