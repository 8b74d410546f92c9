"""``python -m slamcmp.cli``."""

from slamcmp.cli import main

main()
