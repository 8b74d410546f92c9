"""Very many paired runs of planar filters as one program: on the cores of this machine or on a GPU."""
