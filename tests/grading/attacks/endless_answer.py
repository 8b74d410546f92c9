"""Kind: hostile values.
Wins if a container that holds itself hangs the grader.
Defence: depth and size of an answer are capped.
"""


def attack(target):
    answer = []
    answer.append(answer)
    return answer
