"""Kind: reading files.
Wins if the content of the grader's private file comes back.
Defence: own uid, private root, Landlock.
Control: wins without the sandbox.
"""


def attack(target):
    with open(target["private_file"]) as file:
        return file.read()
