"""Kind: changing files.
Wins if a file disappears.
Defence: private root, Landlock, file size limit, seccomp.
Control: wins without the sandbox.
"""

import os


def attack(target):
    os.unlink(target["victim_file"])
