"""Kind: changing files.
Wins if a file is emptied.
Defence: private root, Landlock, file size limit, seccomp.
Control: wins without the sandbox.
"""

import os


def attack(target):
    os.truncate(target["victim_file"], 0)
