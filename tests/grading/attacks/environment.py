"""Kind: reading other processes.
Wins if the secret stands in this process's own environment.
Defence: an environment made from nothing.
"""

import os


def attack(target):
    return dict(os.environ)
