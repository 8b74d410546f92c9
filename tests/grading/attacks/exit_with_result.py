"""Kind: ending the process.
Wins if leaving early with a good mark is believed.
Defence: scores are computed by the grader, an end without an answer is a failure.
"""

import os


def attack(target):
    print('{"score": 100}', flush=True)
    os._exit(0)
