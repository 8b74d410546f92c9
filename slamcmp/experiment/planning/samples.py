"""Whether the samples of an experiment are samples: each one a stream of its own."""

from __future__ import annotations

import json
from typing import Any

from slamcmp.errors import NoSampleError
from slamcmp.experiment.planning.trials import Trial


class Samples:
    """Remembers the streams of each grid point.

    One recording under twelve seeds is one run, whatever its source says: intervals and tests of twelve
    equal numbers would claim what nobody measured.
    """

    def __init__(self) -> None:
        self._seen: dict[tuple[str, str], Trial] = {}

    def add(self, trial: Trial, digest: str) -> None:
        """Take in the stream of a trial.

        Raises:
            NoSampleError: another seed or recording of the same grid point has this very stream.
        """
        point = json.dumps(dict(trial.swept), sort_keys=True, default=str)
        other = self._seen.setdefault((point, digest), trial)
        if other.seed == trial.seed:
            return
        source = trial.stream.source.name
        if trial.recording:
            raise NoSampleError(
                f"source {source!r}: recordings {other.recording!r} and {trial.recording!r} are one "
                f"and the same stream ({digest[:12]}…), and no two samples: name each recording once",
                f"recording {other.recording!r} has this very stream",
            )
        raise NoSampleError(
            f"source {source!r} makes one and the same stream ({digest[:12]}…) of seeds {other.seed} and "
            f"{trial.seed}, and no two samples of it: leave seeds out (a source of recorded data "
            "registers itself with seeded=False), or let what is drawn depend on the seed",
            f"seed {other.seed} has this very stream",
        )


def names_of(trials: list[Trial]) -> dict[str, Any]:
    """What the manifest says of them: the seeds, or the recordings."""
    recordings = list(dict.fromkeys(trial.recording for trial in trials if trial.recording))
    if recordings:
        return {"seeds": [], "recordings": recordings}
    return {"seeds": list(dict.fromkeys(trial.seed for trial in trials if trial.seed is not None))}
