"""Kind: changing files.
Wins if a file that every user may write changes.
Defence: private root, Landlock, file size limit, seccomp.
Control: wins without the sandbox.
"""


def attack(target):
    with open(target["victim_file"], "w") as file:
        file.write("x")
