"""Kind: ending the process.
Wins if a crash takes the grader along or leaves a core file.
Defence: process of its own, no core files.
"""

import os


def attack(target):
    os.abort()
