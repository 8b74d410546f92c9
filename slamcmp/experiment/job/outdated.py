"""What a row says whose code or data is not what was planned."""

from __future__ import annotations

from pathlib import Path

from slamcmp.experiment.job.planned import changed_files, changed_stamp, loaded_before
from slamcmp.experiment.job.task import Task
from slamcmp.support.messages import told


def why_outdated(task: Task) -> str:
    """What a row says whose code or data is not what was planned."""
    names = [*changed_files(task.code), *(Path(path).name for path in task.data if changed_stamp(task, path))]
    if not names:
        # Only what this process itself has loaded can be older than the files: it is no worker.
        old = loaded_before(task.code)
        if old:
            return told(
                f"not run: slamcmp itself was edited ({', '.join(old[:3])}) since this process loaded it; "
                "start Python anew"
            )
    which = f" ({', '.join(names[:3])}{' …' if len(names) > 3 else ''})" if names else ""
    return told(
        f"not run: its code or data changed while the experiment ran{which}; the same command runs it"
    )
