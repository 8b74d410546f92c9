"""Kind: ending the process.
Wins if a stopped process is waited for.
Defence: deadline per request.
Deadline: 0.5 s.
"""

import os
import signal


def attack(target):
    os.kill(os.getpid(), signal.SIGSTOP)
