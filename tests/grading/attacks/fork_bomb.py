"""Kind: starting processes.
Wins if processes of the submission are left or multiply.
Defence: seccomp, thread limit, the process group is killed.
"""

import os
import time


def attack(target):
    won = None
    for _ in range(50):
        if os.fork() == 0:
            os.setsid()
            time.sleep(30)
            os._exit(0)
        won = "WON"
    return won
