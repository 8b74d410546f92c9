"""Kind: changing files.
Wins if the submission changes after its digest was taken.
Defence: private root, Landlock, file size limit, seccomp.
Control: wins without the sandbox.
"""


def attack(target):
    with open(__file__, "w") as file:
        file.write("x")
    return "WON"
