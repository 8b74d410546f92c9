"""Kind: ending the process.
Wins if sys.exit ends more than the request.
Defence: every exception is an answer.
"""

import sys


def attack(target):
    sys.exit("passed")
