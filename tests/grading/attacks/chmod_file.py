"""Kind: changing files.
Wins if the rights of a file change.
Defence: private root, Landlock, file size limit, seccomp.
Control: wins without the sandbox.
"""

import os


def attack(target):
    os.chmod(target["victim_file"], 0o600)
