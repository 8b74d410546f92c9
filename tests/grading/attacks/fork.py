"""Kind: starting processes.
Wins if a child process comes to life.
Defence: seccomp, thread limit.
Control: wins without the sandbox.
"""

import os


def attack(target):
    child = os.fork()
    if child == 0:
        os._exit(0)
    os.waitpid(child, 0)
    return "WON"
