"""Kind: resources.
Wins if an overflow of the stack harms more than this process.
Defence: process of its own, address space limit, deadline.
Deadline: 1 s.
"""

import sys


def attack(target):
    sys.setrecursionlimit(10**9)

    def deeper(n):
        return deeper(n + 1) + [n].__len__()

    return deeper(0)
