"""Run code that nobody trusts, one experiment a process, with evidence of what it could not do.

``session`` is the door for callers; ``policy`` says what a worker may use, ``errors`` what can go wrong.
Inside: ``worker`` is the process, ``protocol`` its language, ``layers`` closes it with one module a layer
(``limits``, ``identity``, ``private_root``, ``landlock``, ``seccomp``; ``bubblewrap`` from outside), and
``proofs`` tries whether it is closed.
"""
