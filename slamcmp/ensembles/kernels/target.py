"""What the bodies of the program are compiled for: one core, or the threads of a GPU's block.

The bodies import ``body``, ``lane``, ``lanes``, ``sync`` and ``add`` from here. Those of a core are what an
ordinary import gives; :func:`slamcmp.ensembles.targets.load` imports the bodies a second time for the GPU.

=========  ==================================================================================
name       meaning
=========  ==================================================================================
body       decorator of every function of the program
lane       the thread's number within its block, 0 on a core
lanes      threads in a block, 1 on a core
sync       wait for all threads of the block
add        add to an element that other blocks may be adding to
=========  ==================================================================================
"""

from __future__ import annotations

from slamcmp.ensembles.targets import chosen

if chosen() == "cuda":
    from slamcmp.ensembles.kernels.block import add, body, lane, lanes, sync
else:
    from slamcmp.ensembles.kernels.core import add, body, lane, lanes, sync

__all__ = ["add", "body", "lane", "lanes", "sync"]
