"""Kind: reading files.
Wins if a system call below Python reads the file.
Defence: private root, Landlock.
Control: wins without the sandbox.
"""

import ctypes


def attack(target):
    libc = ctypes.CDLL(None)
    descriptor = libc.open(target["public_file"].encode(), 0)
    buffer = ctypes.create_string_buffer(200)
    libc.read(descriptor, buffer, 200)
    return buffer.value.decode()
