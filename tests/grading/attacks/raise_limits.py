"""Kind: resources.
Wins if a resource limit can be raised again.
Defence: hard limits, own uid.
"""

import resource


def attack(target):
    won = []
    for which in (resource.RLIMIT_AS, resource.RLIMIT_FSIZE, resource.RLIMIT_NOFILE, resource.RLIMIT_CPU):
        _, hard = resource.getrlimit(which)
        infinite = resource.RLIM_INFINITY
        try:
            resource.setrlimit(which, (infinite, infinite))
        except (ValueError, OSError):
            continue
        if hard != infinite:
            won.append("WON")
    return won
