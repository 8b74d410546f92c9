"""Kind: changing files.
Wins if a file appears in a folder that every user may write.
Defence: private root, Landlock, file size limit, seccomp.
Control: wins without the sandbox.
"""

import os


def attack(target):
    with open(os.path.join(target["writable"], "new"), "w") as file:
        file.write("x")
