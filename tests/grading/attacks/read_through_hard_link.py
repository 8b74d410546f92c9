"""Kind: reading files.
Wins if a hard link made to the file shows it.
Defence: private root, Landlock, seccomp.
Control: wins without the sandbox.
"""

import os


def attack(target):
    link = os.path.join(target["writable"], "hard")
    os.link(target["public_file"], link)
    return open(link).read()
