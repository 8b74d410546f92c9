"""The kinds of test that an assignment can ask for, one a file.

A kind is a function ``kind(trial, *, parameters…) -> Verdict``, registered with
``@test_kinds.register("name")``; its keyword-only parameters are keys of the test in ``assignment.yaml``.
It must ask an implementation for the same things in the same order whatever the answers are, as far as it
can: a wrong answer is explained by comparing all answers with those of known mistakes.
"""
