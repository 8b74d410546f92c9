"""Kind: resources.
Wins if importing never ends.
Defence: deadline per request, kill -9 of the group.
"""

while True:
    pass
