"""Kind: reading files.
Wins if a link made inside a writable folder shows the file.
Defence: private root, Landlock, seccomp.
Control: wins without the sandbox.
"""

import os


def attack(target):
    link = os.path.join(target["writable"], "link")
    os.symlink(target["public_file"], link)
    return open(link).read()
