"""Notebooks as students write them: what is asked for is run with all that it needs, the rest is told."""

from __future__ import annotations

import ast
import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from slamcmp.grading.hand_in.notebook import read_notebook
from slamcmp.grading.hand_in.submission import Submission, SubmissionError, load_submission
from slamcmp.grading.run.source_reader import read_source, told
from slamcmp.grading.sandbox.inside.definitions import definitions


def notebook(*cells: str, markdown: str = "# Title") -> bytes:
    made: list[dict[str, Any]] = [{"cell_type": "markdown", "metadata": {}, "source": [markdown]}]
    for text in cells:
        source = text.splitlines(keepends=True)
        made.append({"cell_type": "code", "metadata": {}, "source": source, "outputs": []})
    return json.dumps({"nbformat": 4, "nbformat_minor": 5, "metadata": {}, "cells": made}).encode()


def loaded(*cells: str) -> tuple[dict[str, Any], list[int]]:
    """The names that are there after loading for ``f``, and the lines where a statement was left out."""
    tree = ast.parse(read_notebook(notebook(*cells), "n.ipynb").source)
    tree.body, left_out = definitions(tree.body, ["f"])
    module = ModuleType("slamcmp_notebook")
    # Dataclasses look their module up by its name.
    sys.modules[module.__name__] = module
    exec(compile(tree, "n.py", "exec"), module.__dict__)
    return vars(module), [statement.lineno for statement in left_out]


BOOM = "boom = 1 / 0\nraise SystemExit\nopen('/nonexistent')\n"
"""Exploration: running any of it would be told by an error."""
RIGHT = {
    "magics": (
        "%matplotlib inline\n!pip install numpy\nimport math\nmath.pi?\n?math\n",
        "def f(x): return 2 * x",
    ),
    "a magic on top of a definition": ("%%time\ndef f(x):\n    return 2 * x",),
    "a magic under an empty line": ("\n%%capture out\ndef f(x):\n    return 2 * x",),
    "another language": ("%%bash\nrm -rf /\ndef f(x) {", "def f(x): return 2 * x"),
    "answers of magics": ("files = !ls\nt = %timeit -o f(3)\n", "def f(x): return 2 * x"),
    "a per cent sign that is no magic": (
        "scale = (7\n% 5)\ntext = '''\n%d\n!\n'''\nword = 'a%d' \\\n% 2\n",
        "def f(x):\n    return scale * x if (text, word) == ('\\n%d\\n!\\n', 'a2') else 0",
    ),
    "brackets and quotes in comments and texts": (
        "a = '(' # [ '''\nb = \"it's\" # (\nc = '\\'('\n%precision 3\n",
        "def f(x): return 2 * x if (a, b, c) == ('(', \"it's\", \"'(\") else 0",
    ),
    "plots on top": (
        "import matplotlib.pyplot as plt\nfig, ax = plt.subplots()\nplt.plot([1])\n",
        "def f(x): return 2 * x",
    ),
    "packages that only exploration uses": (
        "import pandas_of_tomorrow as pd\npd.read_csv('x')",
        "def f(x): return 2 * x",
    ),
    "a value made by a call": (
        "import numpy as np\nI = 2 * np.eye(1)",
        "def f(x): return float(I[0, 0] * x)",
    ),
    "cells out of order": (
        "def f(x): return twice(x)",
        "def twice(x): return FACTOR * x",
        "FACTOR = int('2')",
    ),
    "defined twice": ("def f(x): return 3 * x", BOOM, "def f(x): return 2 * x"),
    "a local name like a result": (
        "def f(x):\n    data = [x]\n    return sum(data) + sum(each for each in data)",
        "data = open('/nonexistent').read()\neach = 1 / 0",
    ),
    "a parameter like a result": ("def f(P): return 2 * P", "P = 1 / 0\n"),
    "results of results": ("def f(x): return 2 * x", "truth = open('/nonexistent')\nerror = truth - 3\n"),
    "import within try": (
        "try:\n    import numba_of_tomorrow as numba\nexcept ImportError:\n    numba = None",
        "def f(x): return 2 * x if numba is None else 0",
    ),
    "a definition within try": (
        "try:\n    from nowhere import f\nexcept ImportError:\n    def f(x):\n        return 2 * x",
    ),
    "a choice": (
        "import sys\nif sys.version_info > (3,):\n    FACTOR = 2\nelse:\n    FACTOR = 0",
        "def f(x): return FACTOR * x",
    ),
    "main guard": ("def f(x): return 2 * x\nif __name__ == '__main__':\n    f = None\n    1 / 0", BOOM),
    "a table filled in a loop": (
        "T = {}\nfor i in range(3):\n    T[i] = 2 * i\n",
        "rows = []\nrows.append(list(T.values()))",
        "def f(x): return rows[0].index(2 * x) * 2",
    ),
    "dataclass and decorators": (
        "from dataclasses import dataclass\nimport functools, typing\nNumber = typing.Optional[float]",
        "def doubled(g):\n    @functools.wraps(g)\n    def inner(x): return 2 * g(x)\n    return inner",
        "@dataclass\nclass State:\n    x: Number = None",
        "@doubled\ndef f(x: Number) -> Number: return State(x).x",
    ),
    "another name for it": ("def my_double(x): return 2 * x", "f = my_double", BOOM),
    "made by a call": (
        "from functools import partial\nimport operator",
        "f = partial(operator.mul, 2)",
        BOOM,
    ),
    "a method added later": (
        "class Filter:\n    pass",
        "def double(self, x): return 2 * x",
        "Filter.double = double",
        "def f(x): return Filter().double(x)",
    ),
    "a global that a function sets": (
        "count = 0",
        "def f(x):\n    global count\n    count += 1\n    return 2 * x * count",
    ),
    "a helper that plots results": (
        "def show():\n    plt.plot(results)",
        "import plotting_of_tomorrow as plt\nresults = 1 / 0",
        "def f(x): return 2 * x",
    ),
    "star import": ("from math import *", "def f(x): return sqrt(4) * x"),
    "empty cells": ("", "   \n\n", "# only a comment", "def f(x): return 2 * x", ""),
    "an unfinished default": ("def g(x=missing): return x", "def f(x): return 2 * x"),
}


@pytest.mark.parametrize("case", RIGHT)
def test_what_is_asked_for_runs_with_all_that_it_needs(case: str) -> None:
    names, _ = loaded(*RIGHT[case])
    assert names["f"](2) == 4
    assert "boom" not in names


def test_without_names_all_definitions_are_wanted() -> None:
    tree = ast.parse("import math\nTWO = math.sqrt(4)\ndef g(x): return TWO * x\nprint(3)\n")
    run, left_out = definitions(tree.body)
    assert [statement.lineno for statement in run] == [1, 2, 3]
    assert [statement.lineno for statement in left_out] == [4]


def test_what_was_left_out_is_told_by_cell(tmp_path: Path) -> None:
    path = tmp_path / "n.ipynb"
    cells = ("import numpy as np\nimport os", "def f(x): return np.sum(x)", "x = np.ones(3)\nprint(f(x))")
    path.write_bytes(notebook(*cells))
    submission = load_submission(path, entry="n.py")
    reading = read_source(submission, ["f", "g"])
    assert reading.unwritten == ("g",)
    # Imports that nothing needs have no effect to be missed.
    assert reading.left_out == ("cell 4, line 1", "cell 4, line 2")
    assert "cell 4, line 1; cell 4, line 2. Start a cell with '# %% submit'" in told(reading.left_out)


def test_format_3_is_read() -> None:
    cells = [
        {"cell_type": "markdown", "source": "text"},
        {
            "cell_type": "code",
            "input": ["def f(x):\n", "    return 2 * x"],
            "language": "python",
            "outputs": [],
        },
    ]
    content = json.dumps({"nbformat": 3, "metadata": {"name": ""}, "worksheets": [{"cells": cells}]}).encode()
    assert read_notebook(content, "n.ipynb").source == "def f(x):\n    return 2 * x\n"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (notebook(), "has no code"),
        (notebook("", " \n"), "has no code"),
        (b"[]", "no notebook of format 4 or 3"),
        (b'{"nbformat": 2}', "no notebook of format 4 or 3"),
        (b'{"cells": [{"cell_type": "code"}]}', "no notebook of format 4 or 3"),
        (b'{"worksheets": 3}', "no notebook of format 4 or 3"),
    ],
)
def test_what_is_no_notebook_is_refused(content: bytes, said: str) -> None:
    with pytest.raises(SubmissionError, match=said):
        read_notebook(content, "n.ipynb")


def test_hostile_lines_take_no_time() -> None:
    source = "(" * 100_000 + "\n" + "'" * 100_001 + "\n" + "%" * 100_000
    assert len(read_notebook(notebook(source), "n.ipynb").lines) == 3
    made = Submission("n", "notebook", {"n.py": source.encode()}, "n.py", definitions_only=True)
    assert read_source(made, ["f"]).unwritten == ()
