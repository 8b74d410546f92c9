"""Files and folders: written whole, packed, locked, named by users."""
