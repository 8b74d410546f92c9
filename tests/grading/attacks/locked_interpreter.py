"""Kind: resources.
Wins if a computation that never gives the interpreter back blocks the deadline.
Defence: deadline per request, kill -9 of the group.
Deadline: 0.5 s.
"""


def attack(target):
    return 7 ** (7**9) % 10
