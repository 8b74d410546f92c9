"""Kind: starting processes.
Wins if a shell command runs.
Defence: seccomp.
Control: wins without the sandbox.
"""

import os


def attack(target):
    os.system(f"echo x > {target['writable']}/shell")
