"""Where jobs run: in worker processes, in this process, or in the session of a notebook."""
