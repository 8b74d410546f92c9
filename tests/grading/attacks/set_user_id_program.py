"""Kind: raising rights.
Wins if a set-uid program can be made.
Defence: own uid, no new privileges, seccomp, Landlock.
Control: wins without the sandbox.
"""

import os


def attack(target):
    os.chmod(target["victim_file"], 0o4755)
