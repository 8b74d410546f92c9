"""Grading: submissions, the sandbox they run in, and what is made of their answers.

Kept free of imports: the sandbox's worker process passes through here while it starts.
"""
