"""Kind: resources.
Wins if the grader keeps all that is printed.
Defence: output is capped while it is read.
"""


def attack(target):
    for _ in range(2000):
        print("x" * 10000)
