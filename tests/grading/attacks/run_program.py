"""Kind: starting processes.
Wins if a program runs.
Defence: seccomp.
Control: wins without the sandbox.
"""

import subprocess


def attack(target):
    return "WON" if subprocess.run(["/bin/echo", "x"], capture_output=True).stdout else None
