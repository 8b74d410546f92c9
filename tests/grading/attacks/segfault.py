"""Kind: ending the process.
Wins if a crash takes the grader along.
Defence: process of its own.
"""

import ctypes


def attack(target):
    ctypes.string_at(0)
