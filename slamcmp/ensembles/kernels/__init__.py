"""The program of one run, written once for a core and for the threads of a GPU's block."""
