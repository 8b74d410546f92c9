"""Figures of runs: over time, over the map, over the frames."""
