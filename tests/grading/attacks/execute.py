"""Kind: starting processes.
Wins if this process becomes a shell.
Defence: seccomp, Landlock.
Control: wins without the sandbox.
"""

import os


def attack(target):
    os.execv("/bin/sh", ["sh", "-c", f"echo x > {target['writable']}/executed"])
