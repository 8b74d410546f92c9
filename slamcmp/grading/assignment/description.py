"""An assignment's folder: what to hand in, which tests there are, the solution, and known mistakes.

``assignment.yaml`` names the tests, ``cases.py`` (or a package ``cases/``, where that is more than one idea)
makes their data, ``solution/`` holds the reference, ``mutants.yaml`` known mistakes as replacements in it,
each with the message a student gets who makes it.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import json
import sys
from collections.abc import Mapping, Set
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from slamcmp.errors import MissingDataError, UsageError
from slamcmp.grading.assignment.handout import (
    SHIPPED,
    SPECIFICATION,
    handouts,
    staff_folder,
    staff_missing,
)
from slamcmp.grading.results.outcome import Visibility
from slamcmp.grading.sandbox.policy import Policy
from slamcmp.registry import Plugin, did_you_mean, test_kinds
from slamcmp.support.configuration.config_errors import ConfigErrors
from slamcmp.support.configuration.plugin_models import bind_parameters, parameter_model
from slamcmp.support.configuration.yaml_source import KeyPath, YamlSource, load_yaml


class LimitFields(BaseModel):
    """What a submission may use."""

    model_config = ConfigDict(extra="forbid")

    memory_mb: float = Field(2048, ge=256, description="Address space of the submission's process")
    load_s: float = Field(10, gt=0, description="Time to import the submission")
    request_s: float = Field(5, gt=0, description="Time for one call or frame")
    test_s: float = Field(60, gt=0, description="Time for one test")
    grader_s: float = Field(60, gt=0, description="Processor time of the grader itself for one test")
    grader_mb: float = Field(256, ge=64, description="Memory that the grader itself may take for answers")


class TestFields(BaseModel):
    """The keys that every test has; all others are parameters of its kind."""

    __test__ = False
    model_config = ConfigDict(extra="forbid")

    name: str = Field(min_length=1, description="What students read; hidden data depend on it")
    kind: str = Field(description="One of the kinds below")
    points: float = Field(gt=0, description="For a test that is passed")
    visibility: Visibility = Field("visible", description="Who sees it, and when")
    after: str | None = Field(None, description="Run only once that test has earned half of its points")
    hint: str = Field("", description="For the student, where marks are lost and no cause is recognised")


class AssignmentFields(BaseModel):
    """The keys of ``assignment.yaml``."""

    model_config = ConfigDict(extra="forbid")

    title: str = Field(description="As the first line of README.md")
    entry: str = Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*\.py$", description="File to hand in")
    functions: list[str] = Field(min_length=1, description="Functions and classes that it defines")
    packages: list[str] = Field(["numpy", "scipy"], description="What it may import")
    modules: list[str] = Field(["slamcmp.models.sensors"], description="Parts of slamcmp it may import")
    limits: LimitFields = Field(LimitFields.model_construct(), description="What a submission may use")
    tests: list[dict[str, Any]] = Field(min_length=1, description="In the order in which they are run")


MESSAGE_FIELDS = ("{yours}", "{expected}", "{call}", "{function}")
"""What a mutant's message can tell: two numbers, the number of a call, and what was called."""


class MutantFields(BaseModel):
    """One known mistake: text of the solution replaced by other text."""

    model_config = ConfigDict(extra="forbid")

    name: str = Field(description="For the staff")
    old: str = Field(description="Text of the solution that stands there once")
    new: str = Field(description="What a student with the mistake has in its place")
    message: str = Field(
        description="For the student; {yours}, {expected}, {call} and {function} are filled in"
    )


class MutantsFields(BaseModel):
    """The keys of ``mutants.yaml``."""

    model_config = ConfigDict(extra="forbid")

    mutants: list[MutantFields] = Field(min_length=1)


@dataclass(frozen=True)
class TestSpec:
    """One test of an assignment."""

    __test__ = False

    fields: TestFields
    plugin: Plugin
    parameters: Mapping[str, Any]


@dataclass(frozen=True)
class Mutant:
    """A known mistake."""

    name: str
    source: str
    """The whole solution with the mistake."""
    message: str
    changed: frozenset[str] = frozenset()
    """Functions of the solution that it changes, and all that call them, directly or not."""

    def touches(self, functions: Set[str]) -> bool:
        """Whether it can show in answers of these functions (none named: of anything)."""
        return not functions or bool(self.changed & functions)


@dataclass(frozen=True)
class Assignment:
    """A checked assignment; the modules in it are the course's own and run in the grader's process."""

    folder: Path
    fields: AssignmentFields
    tests: tuple[TestSpec, ...]
    mutants: tuple[Mutant, ...]
    solution_source: str
    digest: str
    """sha256 (hex) of everything in the folder."""

    @property
    def name(self) -> str:
        """The folder's."""
        return self.folder.name

    @property
    def policy(self) -> Policy:
        """Limits of a submission's process."""
        limits = self.fields.limits
        return Policy(
            packages=tuple(self.fields.packages),
            modules=tuple(self.fields.modules),
            memory_bytes=int(limits.memory_mb) << 20,
            cpu_s=limits.test_s + 10,
            load_s=limits.load_s,
            request_s=limits.request_s,
        )

    @functools.cached_property
    def cases(self) -> ModuleType:
        """``cases.py``, or the package ``cases``, imported."""
        name, path = f"slamcmp_cases_{self.name}", _cases_file(self.folder)
        return load_source(name, path.read_text(encoding="utf-8"), path)

    def solution(self) -> ModuleType:
        """The solution as a new module, with no state left by earlier tests."""
        return load_source(f"slamcmp_solution_{self.name}", self.solution_source, self.folder / "solution")

    def mutated(self, mutant: Mutant) -> ModuleType:
        """The solution with a known mistake, as a new module."""
        return load_source(
            f"slamcmp_mutant_{self.name}", mutant.source, self.folder / f"mutant {mutant.name}"
        )


def find_assignment(name: str | Path) -> Path:
    """The folder of an assignment: a path, or the name of one of the staff's or a shipped one.

    Raises:
        MissingDataError: there is none, or only its students' part.
    """
    staff = staff_folder()
    for folder in (Path(name), *([] if staff is None else [staff / name]), SHIPPED / name):
        if (folder / SPECIFICATION).is_file():
            return folder.resolve()
    known = handouts()
    if str(name) in known:
        raise MissingDataError(staff_missing(f"assignment {str(name)!r}"))
    raise MissingDataError(
        f"assignment {str(name)!r}: there is no {name}/{SPECIFICATION}{did_you_mean(str(name), known)}"
    )


def load_assignment(folder: Path) -> Assignment:
    """Read and check an assignment.

    Raises:
        MissingDataError: a file is missing.
        ConfigError: a file has mistakes; the message lists all of them with line and column.
        UsageError: the solution does not fit the assignment.
    """
    folder = find_assignment(folder)
    source = load_yaml(folder / SPECIFICATION)
    fields, tests = _checked_tests(source)
    solution_path = folder / "solution" / "solution.py"
    for path in (solution_path, _cases_file(folder)):
        if not path.is_file():
            raise MissingDataError(f"{path}: no such file; an assignment needs it")
    solution = solution_path.read_text(encoding="utf-8")
    mutants_path = folder / "mutants.yaml"
    mutants = _checked_mutants(load_yaml(mutants_path), solution) if mutants_path.is_file() else ()
    return Assignment(folder, fields, tests, mutants, solution, _digest(folder))


def _cases_file(folder: Path) -> Path:
    package = folder / "cases" / "__init__.py"
    return package if package.is_file() else folder / "cases.py"


def load_source(name: str, source: str, path: Path) -> ModuleType:
    """A new module from text of the course's own; ``path`` stands in tracebacks.

    Where that is an ``__init__.py``, what lies beside it can be imported from it.

    Raises:
        UsageError: it does not import.
    """
    module = ModuleType(name)
    module.__file__ = str(path)
    if path.name == "__init__.py":
        # Another assignment of the same name may have been read before.
        for loaded in [each for each in sys.modules if each.startswith(f"{name}.")]:
            del sys.modules[loaded]
        module.__path__ = [str(path.parent)]
    # Dataclasses look their module up by its name.
    sys.modules[name] = module
    try:
        exec(_compiled(source, str(path)), module.__dict__)
    except Exception as error:
        raise UsageError(f"{path}: does not import: {error!r}") from error
    return module


@functools.lru_cache(maxsize=256)
def _compiled(source: str, path: str) -> CodeType:
    """A mutant is started anew for every test that it may explain."""
    return compile(source, path, "exec")


def _checked_tests(source: YamlSource) -> tuple[AssignmentFields, tuple[TestSpec, ...]]:
    errors = ConfigErrors(source)
    try:
        fields = AssignmentFields.model_validate_json(json.dumps(source.data, default=str), strict=True)
    except ValidationError as error:
        known: dict[KeyPath, Any] = {
            (): AssignmentFields.model_fields,
            ("limits",): LimitFields.model_fields,
        }
        errors.add_pydantic(error.errors(), (), known)
        errors.raise_if_any()
        raise
    tests = []
    names: set[str] = set()
    for index, given in enumerate(fields.tests):
        place: KeyPath = ("tests", index)
        common = {key: value for key, value in given.items() if key in TestFields.model_fields}
        own = {key: value for key, value in given.items() if key not in common}
        try:
            test = TestFields.model_validate_json(json.dumps(common), strict=True)
        except ValidationError as error:
            errors.add_pydantic(error.errors(), place, {place: TestFields.model_fields})
            continue
        if test.name in names:
            errors.add((*place, "name"), f"a test called {test.name!r} stands above already")
        if test.after is not None and test.after not in names:
            errors.add((*place, "after"), f"no test above has this name{did_you_mean(test.after, names)}")
        names.add(test.name)
        if test.kind not in test_kinds:
            what = f"unknown kind of test {test.kind!r}{did_you_mean(test.kind, test_kinds.names())}"
            errors.add((*place, "kind"), what)
            continue
        plugin = test_kinds.get(test.kind)
        try:
            tests.append(TestSpec(test, plugin, bind_parameters(plugin, own)))
        except ValidationError as error:
            keys = (*TestFields.model_fields, *parameter_model(plugin).model_fields)
            errors.add_pydantic(error.errors(), place, {place: keys})
    errors.raise_if_any()
    return fields, tuple(tests)


def _checked_mutants(source: YamlSource, solution: str) -> tuple[Mutant, ...]:
    errors = ConfigErrors(source)
    try:
        given = MutantsFields.model_validate_json(json.dumps(source.data, default=str), strict=True)
    except ValidationError as error:
        places: dict[KeyPath, Any] = {(): MutantsFields.model_fields}
        places |= {("mutants", index): MutantFields.model_fields for index in range(1000)}
        errors.add_pydantic(error.errors(), (), places)
        errors.raise_if_any()
        raise
    mutants = []
    for index, mutant in enumerate(given.mutants):
        count = solution.count(mutant.old)
        if count != 1:
            what = f"stands {count} times in solution.py; a mutant replaces what stands there once"
            errors.add(("mutants", index, "old"), what)
        if fault := _unfilled(mutant.message):
            errors.add(("mutants", index, "message"), fault)
        mistaken = solution.replace(mutant.old, mutant.new)
        try:
            changed = changed_functions(solution, mistaken)
        except SyntaxError as error:
            errors.add(
                ("mutants", index, "new"), f"makes no Python of solution.py: {error.msg}, line {error.lineno}"
            )
            continue
        mutants.append(Mutant(mutant.name, mistaken, mutant.message, changed))
    errors.raise_if_any()
    return tuple(mutants)


def _unfilled(message: str) -> str:
    """What of a message could not be filled in, or nothing."""
    try:
        message.format(function="predict", call=1, yours=1.0, expected=2.0)
    except (KeyError, IndexError, AttributeError, TypeError):
        return f"may hold {', '.join(MESSAGE_FIELDS)} in braces, and no other; write {{{{ and }}}} for braces"
    except ValueError as error:
        return f"is no template: {error}; write {{{{ and }}}} for braces"
    return ""


def changed_functions(solution: str, mutant: str) -> frozenset[str]:
    """Top-level functions and classes whose text differs, and all that mention them, directly or not."""
    before, after = _definitions(solution), _definitions(mutant)
    mentions: dict[str, frozenset[str]] = {name: mentioned for name, (_, mentioned) in before.items()}
    changed = set()
    for name in before.keys() | after.keys():
        (old, used), (new, used_now) = (side.get(name, ("", frozenset())) for side in (before, after))
        if old != new:
            changed.add(name)
        mentions[name] = used | used_now
    if not changed:
        # Something outside of all functions: it may show anywhere.
        return frozenset(before)
    while more := {name for name, used in mentions.items() if used & changed} - changed:
        changed |= more
    return frozenset(changed)


@functools.lru_cache(maxsize=8)
def _definitions(source: str) -> dict[str, tuple[str, frozenset[str]]]:
    """Top-level functions and classes: their text, and the names that stand in them."""
    lines = source.splitlines()
    found = {}
    for node in ast.parse(source).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            first = min([node.lineno, *(each.lineno for each in node.decorator_list)])
            text = "\n".join(lines[first - 1 : node.end_lineno])
            found[node.name] = text, _names_in(text)
    return found


@functools.lru_cache(maxsize=512)
def _names_in(text: str) -> frozenset[str]:
    """Most functions of a mutant are the solution's, and looked at once."""
    return frozenset(each.id for each in ast.walk(ast.parse(text)) if isinstance(each, ast.Name))


def _digest(folder: Path) -> str:
    hasher = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            content = path.read_bytes()
            name = path.relative_to(folder).as_posix().encode()
            hasher.update(b"%d:%s%d:" % (len(name), name, len(content)) + content)
    return hasher.hexdigest()
