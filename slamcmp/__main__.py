"""``python -m slamcmp``: the command line where its script is not on the path."""

from slamcmp.cli import main

main()
