"""What it takes to run an experiment again: its exact file, versions, command; and whether this is the place.

A result is promised again where the text of the code that makes the stream and runs each back end, and the
versions of the libraries that compute, are those of the manifest. Processor and operating system change
times, and can change the last bits.
"""

from __future__ import annotations

import io
import shlex
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

import slamcmp
from slamcmp.errors import SlamcmpError, UsageError
from slamcmp.experiment.config.experiment import load_experiment
from slamcmp.experiment.gathering.manifest import code, cpu_name, platform_name, python_version
from slamcmp.results.store import IMPORTED, Results
from slamcmp.support.files.atomic import write_atomically
from slamcmp.support.files.paths import is_file
from slamcmp.support.provenance.code_version import versions

FILES = ("experiment.yaml", "requirements.txt", "reproduce.sh")
NO_PACKAGE = ("python",)
"""Among the versions, what pip does not install."""
TIMES_ONLY = ("cpu", "platform")


@dataclass(frozen=True)
class Checked:
    """One thing that the results depend on, then and now."""

    what: str
    then: str
    now: str
    decides: bool
    """Whether results may differ by more than times and last bits."""

    @property
    def same(self) -> bool:
        """Whether it is as it was."""
        return self.then == self.now


@dataclass(frozen=True)
class Reproduction:
    """The files that were written, and what was compared."""

    folder: Path
    files: tuple[Path, ...]
    checked: tuple[Checked, ...]
    notes: tuple[str, ...] = ()

    @property
    def same(self) -> bool:
        """Whether this installation is the one of the results, as far as results go."""
        return all(each.same or not each.decides for each in self.checked)


def write_reproduction(results: Results, folder: Path | None = None) -> Reproduction:
    """Write ``experiment.yaml``, ``requirements.txt`` and ``reproduce.sh``, and check this installation.

    ``folder`` is ``repro`` in the results folder by default. Plug-ins of the user's own are copied beside the
    file, as far as they are still beside the experiment's.

    Raises:
        UsageError: the results are of no experiment file: imported, or made of classes of a notebook.
        StorageError: the folder cannot be written.
    """
    manifest = results.manifest
    _require_experiment(results)
    folder = results.folder / "repro" if folder is None else folder
    plugins, notes = _own_plugins(manifest)
    texts = {
        "experiment.yaml": _yaml_text(manifest),
        "requirements.txt": _requirements(manifest),
        "reproduce.sh": _script(manifest),
    }
    for name, text in texts.items():
        content = text.encode("utf-8", "replace")
        write_atomically(folder / name, lambda file, content=content: file.write(content))  # type: ignore[misc]
    for name, path in plugins.items():
        if path.resolve() != (folder / name).resolve():
            shutil.copyfile(path, folder / name)
    checked = [*_versions(manifest), *_code(manifest, folder / "experiment.yaml", notes)]
    written = tuple(folder / name for name in (*texts, *plugins))
    return Reproduction(folder, written, tuple(checked), tuple(notes))


def _require_experiment(results: Results) -> None:
    config = results.manifest.get("config") or {}
    if (config.get("source") or {}).get("name") in (None, IMPORTED):
        raise UsageError(
            f"{results.folder}: imported trajectories have no experiment that could be run again"
        )
    session = results.manifest.get("in_session")
    if session:
        raise UsageError(
            f"{results.folder}: {', '.join(session)} came from a notebook or a running program; put the "
            "class into a file (its text is in the manifest under in_session) and run that"
        )


def _own_plugins(manifest: Mapping[str, Any]) -> tuple[dict[str, Path], list[str]]:
    """Files of the user's own that the configuration names, by their name; and those that are gone."""
    config = manifest["config"]
    sections = [config["source"], config.get("front_end") or {}, *config.get("back_ends", [])]
    names = {str(each["name"]).rpartition(":")[0] for each in sections if ".py:" in str(each.get("name"))}
    file = manifest.get("config_file")
    found, notes = {}, []
    for name in sorted(names):
        path = Path(name) if file is None else Path(file).parent / name
        if is_file(path):
            found[Path(name).name] = path
        else:
            notes.append(f"{name}: is not beside {file or 'the experiment'}; put it beside experiment.yaml")
    return found, notes


def _yaml_text(manifest: Mapping[str, Any]) -> str:
    """The configuration with every default, without what it leaves out."""
    config = {key: value for key, value in manifest["config"].items() if value not in (None, "", {}, [])}
    if config.get("seeds") == [None]:
        del config["seeds"]
    buffer = io.StringIO()
    yaml = YAML()
    yaml.default_flow_style = False
    yaml.width = 110
    yaml.dump(config, buffer)
    about = [
        f"As run by slamcmp {_slamcmp(manifest)}, {manifest.get('created', 'at an unknown time')};",
        "every default is written out. See reproduce.sh.",
    ]
    return "".join(f"# {line}\n" for line in about) + buffer.getvalue()


def _requirements(manifest: Mapping[str, Any]) -> str:
    known = manifest.get("versions") or {}
    pins = [
        f"{name}=={version}"
        for name, version in known.items()
        if name not in (*NO_PACKAGE, "slamcmp") and version not in ("absent", "without a version")
    ]
    commit = _commit(manifest)
    head = [f"# Python {manifest.get('python', known.get('python', 'of unknown version'))}"]
    # Named, not pinned: a commit may be of no release.
    head += [f"# slamcmp {known.get('slamcmp', '')}{f', commit {commit}' if commit else ''}"]
    return "\n".join([*head, *pins]) + "\n"


def _script(manifest: Mapping[str, Any]) -> str:
    lines = [
        "#!/bin/sh",
        f"# As it was run: {' '.join(str(manifest.get('command') or 'not known').split())}",
        "# pip install -r requirements.txt",
        'cd "$(dirname "$0")" || exit 2',
        f"slamcmp run experiment.yaml --results {shlex.quote('results/' + str(manifest['name']))}",
    ]
    return "\n".join(lines) + "\n"


def _versions(manifest: Mapping[str, Any]) -> list[Checked]:
    then = {str(name): str(version) for name, version in (manifest.get("versions") or {}).items()}
    here = {"slamcmp": slamcmp.__version__, **versions()}
    # What decides is the code by its text; a version of slamcmp alone only says where to get it.
    found = [
        Checked(name, version, here.get(name, "absent"), name != "slamcmp") for name, version in then.items()
    ]
    present = {"python": python_version(), "cpu": cpu_name(), "platform": platform_name()}
    return found + [
        Checked("Python, whole version" if name == "python" else name, str(manifest[name]), now, False)
        for name, now in present.items()
        if manifest.get(name)
    ]


def _code(manifest: Mapping[str, Any], file: Path, notes: list[str]) -> list[Checked]:
    then = manifest.get("code") or {}
    if not then:
        notes.append("the code by its text is not known: the results are of an older version")
    try:
        now = code(load_experiment(file))
    except SlamcmpError as error:
        notes.append(f"the file does not load here: {' '.join(str(error).split())}")
        return [Checked("the experiment's file", "loads", "does not load", True)]
    return [
        Checked(f"code of {part}", str(version)[:12], now.get(part, "absent")[:12], True)
        for part, version in then.items()
    ]


def _slamcmp(manifest: Mapping[str, Any]) -> str:
    commit = _commit(manifest)
    return f"{(manifest.get('versions') or {}).get('slamcmp', '')}{f', commit {commit}' if commit else ''}"


def _commit(manifest: Mapping[str, Any]) -> str:
    known = manifest.get("commit")
    if not isinstance(known, Mapping):
        return str(known or "")
    return f"{known.get('sha')}{' with uncommitted changes' if known.get('dirty') else ''}"
