"""Kind: network.
Wins if a local socket without a file can be made.
Defence: seccomp, Landlock.
Control: wins without the sandbox.
"""

import socket


def attack(target):
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as server:
        server.bind("\0slamcmp-attack")
        server.listen()
    return "WON"
