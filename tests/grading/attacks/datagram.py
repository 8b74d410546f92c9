"""Kind: network.
Wins if a datagram is sent.
Defence: seccomp, Landlock.
Control: wins without the sandbox.
"""

import socket


def attack(target):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as connection:
        connection.sendto(b"x", ("127.0.0.1", target["port"]))
    return "WON"
