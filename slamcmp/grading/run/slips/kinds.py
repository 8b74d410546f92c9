"""What may be done otherwise, in the words for a student: each ends "Your f answers as if …"."""

from __future__ import annotations

import ast
from dataclasses import dataclass

SIGN = "a sign were turned round"
TERM = "a term were left out"
FACTOR = "a factor were left out"
TWICE, HALF = "something counted twice", "something counted half"
HALF_OR_TWICE = "something counted half (or twice, where it divides)"
ROOT, SQUARED = "a root were too much or a square missing", "a square were too much or a root missing"
DIAGONAL = "only a diagonal counted"
DEGREES = "degrees and radians were exchanged"
TRANSPOSE = "a matrix stood where its transpose belongs"
INVERSE = "a matrix stood where its inverse belongs, or the other way round"
ORDER = "two factors stood in the other order"
BY_ENTRY = "matrices were multiplied entry by entry (*), where their product (@) is needed"
OFF_BY_ONE = "an index were off by one"
CONSTANT = "a number in it were another one"
EXCHANGED = "two things stood in each other's place"
OUTPUTS = "its outputs stood in another order"
CONDITION = "a condition were left out"
CONDITION_TURNED = "a condition were turned round"
ANOTHER = "one quantity stood in another's place"
PRODUCT = "a product stood where a sum belongs"
COMPLEMENT = "something stood for what is left of 1"
LEFT_OUT = "a step were left out"
FACTOR_MORE, TERM_MORE = "a factor were too much", "a term were too much"
STEP_LESS = "there were one step less"
DIAGONAL_INVERTED = "only the diagonal of a matrix were inverted"
FACTOR_TWICE = "a factor counted twice (squared)"
INDEX = "an index were another one"
FIRST_FOR_ALL = "the first of several stood for all of them, or for another one (a wrong index)"
OTHER_END = "an index counted from the other end"
REVERSED = "a sequence stood in another order"
SHUFFLED = "entries stood in another order"
SORTED = "a sequence were sorted"
PARENTHESIS = "a parenthesis stood in another place"
IN_PLACE = "what was kept were overwritten in place by what comes later"
STEPS_ORDER = "two of its steps stood in the other order"
UNDER_CONDITION = "something were done under a condition only, where it is always done"
ONCE = "something were done once, before the loop, where every step needs it anew"
NOT_EMPTY = "a list had one thing more at its beginning"
FRONT = "what is new were put in front, where it belongs behind"
JOINED = "parts were put together in another order"
VAGUE = (
    CONSTANT,
    UNDER_CONDITION,
    SORTED,
    SHUFFLED,
    INDEX,
    FACTOR_MORE,
    FACTOR_TWICE,
    TERM_MORE,
    LEFT_OUT,
    STEP_LESS,
    ANOTHER,
    EXCHANGED,
    FACTOR,
    DIAGONAL,
    TERM,
)
"""These say less than what else says the same; the first the least."""


@dataclass(frozen=True)
class Change:
    """A node to put in another's place."""

    kind: str
    """What is done otherwise, as the end of "answers as if …"."""
    new: ast.AST
    about: tuple[ast.AST, ...] = ()
    """What of the formula it is about."""
    text: str = ""
    """The same of one thing that the function is given, by its name."""
