"""Seeds of hidden tests: another set for every student, the same at every grading, guessed by nobody."""

from __future__ import annotations

import hashlib
import hmac

import numpy as np

from slamcmp.errors import UsageError

SECRET_BYTES_MIN = 16


def check_secret(secret: bytes) -> bytes:
    """The secret without white space around it.

    Raises:
        UsageError: it is too short to be one.
    """
    secret = secret.strip()
    if len(secret) < SECRET_BYTES_MIN:
        raise UsageError(
            f"the grading secret has {len(secret)} bytes; at least {SECRET_BYTES_MIN} are needed, "
            "e.g. from python -c 'import secrets; print(secrets.token_hex(32))'"
        )
    return secret


def hidden_seed(secret: bytes, assignment: str, student: str, purpose: str) -> int:
    """HMAC-SHA256 of what the seed is for, as an integer of 128 bits."""
    # Lengths in front: no two tuples of names make the same message.
    parts = [part.encode() for part in (assignment, student, purpose)]
    message = b"".join(b"%d:%s" % (len(part), part) for part in parts)
    return int.from_bytes(hmac.new(secret, message, hashlib.sha256).digest()[:16], "big")


def hidden_generator(secret: bytes, assignment: str, student: str, purpose: str) -> np.random.Generator:
    """A generator from :func:`hidden_seed`."""
    return np.random.Generator(np.random.PCG64(hidden_seed(secret, assignment, student, purpose)))
