"""Kind: resources.
Wins if the grader waits for ever.
Defence: deadline per request, kill -9 of the group.
Deadline: 0.5 s.
"""


def attack(target):
    while True:
        pass
