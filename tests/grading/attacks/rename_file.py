"""Kind: changing files.
Wins if a file changes its name.
Defence: private root, Landlock, file size limit, seccomp.
Control: wins without the sandbox.
"""

import os


def attack(target):
    os.rename(target["victim_file"], target["victim_file"] + ".old")
