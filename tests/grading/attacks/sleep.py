"""Kind: resources.
Wins if the grader waits for ever.
Defence: deadline per request, kill -9 of the group.
Deadline: 0.5 s.
"""

import time


def attack(target):
    time.sleep(1e6)
