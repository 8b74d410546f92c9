"""Data sets on this machine: downloading, unpacking and checking what others published."""
