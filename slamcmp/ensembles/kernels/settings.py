"""The numbers that the program is told: their places in two arrays, which a GPU can be given."""

from __future__ import annotations

TIME_STEP, SPEED_SIGMA, TURN_SIGMA, LATERAL_SIGMA = 0, 1, 2, 3
"""[s]; of one part of a step [m/s, rad/s]; side slip of a step [m]."""
FIRST_SIGMA, SECOND_SIGMA = 4, 5
"""Of a measurement's two numbers [m or rad]."""
NEAREST, FARTHEST, HALF_VIEW = 6, 7, 8
"""Range [m] and half the field of view [rad]."""
PRIOR_POSITION, PRIOR_HEADING = 9, 10
"""Standard deviations of the start [m, rad]."""
TOO_FAR = 11
"""From which distance of linearisation points a filter gives up (far_points.py)."""
RADIUS, GAP_MIN, GAP_MAX = 12, 13, 14
"""Of an annulus of landmarks round the path [m]."""
NUMBERS = 15

CHART, POLICY, POLAR, JOIN_FIRST, FIRST_LOOK, PARTS, OWN_MAP = 0, 1, 2, 3, 4, 5, 6
"""Options; OWN_MAP: each run draws its own annulus of landmarks."""
OPTIONS = 7

WORLD, RIGHT = 0, 1
"""Charts: errors additive in the world's axes; right-invariant."""
LATEST, FIRST, FIRST_BUT_NEW, CONSTRAINED, TRUTH = 0, 1, 2, 3, 4
"""Policies of linearisation (linearisation.py)."""

SQUARED_POSITION, SQUARED_HEADING, NEES_HEADING, NEES_POSITION, NEES_POSE = 0, 1, 2, 3, 4
SCORES = 5
"""A run's means over its frames: [m^2], [rad^2], and NEES over their dimension."""
NEES_FROM = 10
"""Earlier frames count as 0 (results/judgements/ensemble.py)."""
