"""slamcmp: filter or smooth? One front end, many back ends, compared with evidence."""

__version__ = "0.1.0"
