"""Kind: forging answers.
Wins if closing the pipes hangs the grader.
Defence: nonce per request, strict frames.
"""

import os
import time


def attack(target):
    for pipe in (*target["pipes"], 1, 2):
        os.close(pipe)
    time.sleep(1e6)
