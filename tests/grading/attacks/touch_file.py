"""Kind: changing files.
Wins if the time stamp of a file changes.
Defence: private root, Landlock, file size limit, seccomp.
Control: wins without the sandbox.
"""

import os


def attack(target):
    os.utime(target["victim_file"], (1, 1))
