"""Kind: starting processes.
Wins if posix_spawn starts a program.
Defence: seccomp.
Control: wins without the sandbox.
"""

import os


def attack(target):
    child = os.posix_spawn("/bin/true", ["true"], {})
    os.waitpid(child, 0)
    return "WON"
